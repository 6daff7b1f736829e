"use strict";

// What Python said, JSON-ready.
const facts = JSON.parse(document.getElementById("facts").textContent);

/** Unpack what Python packed under a name: gzip in base64 into an ArrayBuffer. */
async function unpack(name) {
  const holder = document.getElementById(`packed-${name}`);
  const packed = await fetch(`data:application/gzip;base64,${holder.textContent}`);
  const stream = packed.body.pipeThrough(new DecompressionStream("gzip"));
  return new Response(stream).arrayBuffer();
}

/** Find an element by its id. */
function byId(id) {
  return document.getElementById(id);
}

/** Turn "#rrggbb" into the 32-bit pixel that ImageData holds on a little-endian machine. */
function pixelOf(colour) {
  const value = parseInt(colour.slice(1), 16);
  return (0xff000000 | ((value & 255) << 16) | (value & 0xff00) | (value >> 16)) >>> 0;
}

/**
 * Draw a layout, one pixel a tile; CSS or drawImage enlarges it without blurring.
 * tiles: Uint8Array of rows * cols indices, colours: "#rrggbb" by index.
 */
function drawTiles(canvas, tiles, rows, cols, colours) {
  const pixels = new Uint32Array(rows * cols);
  const palette = colours.map(pixelOf);
  for (let cell = 0; cell < pixels.length; cell++) pixels[cell] = palette[tiles[cell]];
  canvas.width = cols;
  canvas.height = rows;
  const image = new ImageData(new Uint8ClampedArray(pixels.buffer), cols, rows);
  canvas.getContext("2d").putImageData(image, 0, 0);
}

/** Offer a text as a file to save. */
function saveText(name, text) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([text], {type: "application/json"}));
  link.download = name;
  link.click();
  URL.revokeObjectURL(link.href);
}
