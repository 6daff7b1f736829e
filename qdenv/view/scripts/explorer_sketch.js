"use strict";

const MARGIN = {l: 64, r: 76, t: 8, b: 48}; // pixels around the map, for its axes and colours
const SHADES = 256;

/** The two axes before the library has drawn them: as long as it will make them. */
function sketchedAxes() {
  const {clientWidth, clientHeight} = byId("plot");
  const [wide, tall] = [clientWidth - MARGIN.l - MARGIN.r, clientHeight - MARGIN.t - MARGIN.b];
  const [across, up] = AXES;
  return [linear(MARGIN.l, wide, across.low, across.high), linear(MARGIN.t, tall, up.high, up.low)];
}

/** An axis with the value `from` at its beginning and `to` at its end. */
function linear(offset, length, from, to) {
  return {
    offset, length, pixels: (value) => (value - from) / (to - from) * length,
    value: (pixel) => from + pixel / length * (to - from),
  };
}

/** Colours between those of the scale, as pixels. */
function shades() {
  const stops = facts.scale.map((colour) => [1, 3, 5].map((at) => parseInt(colour.slice(at, at + 2), 16)));
  return Array.from({length: SHADES}, (_, k) => {
    const place = k / (SHADES - 1) * (stops.length - 1);
    const before = Math.min(Math.floor(place), stops.length - 2);
    const mixed = stops[before].map((part, c) => Math.round(part + (place - before) * (stops[before + 1][c] - part)));
    return pixelOf(`#${mixed.map((part) => part.toString(16).padStart(2, "0")).join("")}`);
  });
}

/** Draw the map without axes: there at once, and read as well, until the library has loaded. */
function drawSketch() {
  const [wide, tall] = AXES.map((axis) => axis.cells);
  const [low, high] = colourRange(state.colour);
  const pixels = new Uint32Array(wide * tall).fill(pixelOf(EMPTY));
  const colours = shades();
  state.values[state.colour].forEach((value, row) => {
    const [i, j] = placeOf(row);
    const shade = Math.round(Math.min(1, Math.max(0, (value - low) / (high - low))) * (SHADES - 1));
    if (Number.isFinite(value)) pixels[(tall - 1 - j) * wide + i] = colours[shade];
  });
  const canvas = byId("sketch");
  canvas.width = wide;
  canvas.height = tall;
  canvas.getContext("2d").putImageData(new ImageData(new Uint8ClampedArray(pixels.buffer), wide, tall), 0, 0);
  const [x, y] = sketchedAxes();
  Object.assign(canvas.style, {left: `${x.offset}px`, top: `${y.offset}px`, width: `${x.length}px`, height: `${y.length}px`});
}
