"use strict";

const SIDE = 720; // pixels of the longer side of a drawn layout, about
const LINES = "#00000018"; // between tiles
const PALE = "#ffffffb0"; // over cells that are alike

/** List the cells in which two layouts differ. */
function differing(one, other) {
  return [...one.keys()].filter((cell) => one[cell] !== other[cell]);
}

/** List the cells in which they do not. */
function alike(one, other) {
  return [...one.keys()].filter((cell) => one[cell] === other[cell]);
}

/** Draw a layout with thin lines between tiles, a frame around some cells, and others paled. */
function drawLayout(canvas, tiles, framed = [], paled = []) {
  const side = Math.max(3, Math.round(SIDE / Math.max(facts.rows, facts.cols)));
  const small = document.createElement("canvas");
  drawTiles(small, tiles, facts.rows, facts.cols, facts.colours);
  canvas.width = facts.cols * side;
  canvas.height = facts.rows * side;
  const pen = canvas.getContext("2d");
  pen.imageSmoothingEnabled = false;
  pen.drawImage(small, 0, 0, canvas.width, canvas.height);
  if (side >= 8) ruleLines(pen, side);
  frameCells(pen, side, framed);
  pen.fillStyle = PALE;
  for (const cell of paled) pen.fillRect(cell % facts.cols * side, Math.floor(cell / facts.cols) * side, side, side);
}

/** Draw the lines between tiles. */
function ruleLines(pen, side) {
  pen.strokeStyle = LINES;
  pen.lineWidth = 1;
  pen.beginPath();
  for (let row = 1; row < facts.rows; row++) {
    pen.moveTo(0, row * side);
    pen.lineTo(facts.cols * side, row * side);
  }
  for (let col = 1; col < facts.cols; col++) {
    pen.moveTo(col * side, 0);
    pen.lineTo(col * side, facts.rows * side);
  }
  pen.stroke();
}

/** Frame some cells. */
function frameCells(pen, side, cells) {
  const width = Math.max(1.5, side * 0.16);
  pen.strokeStyle = facts.mark;
  pen.lineWidth = width;
  for (const cell of cells) {
    const row = Math.floor(cell / facts.cols);
    const col = cell % facts.cols;
    pen.strokeRect(col * side + width / 2, row * side + width / 2, side - width, side - width);
  }
}

/** Say what the tiles' colours mean. */
function drawLegend() {
  facts.tile_names.forEach((name, kind) => { addToLegend(name).style.background = facts.colours[kind]; });
  if (facts.repairs) addToLegend("changed by the repair").className = "framed";
}

/** Add a word to the legend and give its swatch. */
function addToLegend(name) {
  const entry = document.createElement("span");
  const swatch = document.createElement("i");
  entry.append(swatch, name);
  byId("legend").append(entry);
  return swatch;
}
