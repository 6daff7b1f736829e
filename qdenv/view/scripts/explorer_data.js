"use strict";

// All that changes. A row is an elite's place in archive.npz; null stands for none.
const state = {
  cells: null, // Int32Array: the archive's cell of each row
  values: [], // Float32Array of each column
  runs: null, // Float32Array, simulations of each row one after the other
  rowOf: null, // Int32Array: the row in each cell of the archive, -1 where it is empty
  chunks: new Map(), // promises of what is unpacked, by name
  grownAt: new Map(facts.growth.rows.map((row, place) => [row, place])),
  colour: facts.colour, // column that colours the map
  pins: [null, null],
  pointed: null,
  focus: 0, // whose growth is shown, A or B
  frames: null, // of the growth that is shown
  drawn: null, // layout before the repair of the same elite
  repaired: null,
  timer: null, // while growth plays
};

const AREA = facts.rows * facts.cols;
// An archive of one measure is a strip: one cell high.
const AXES = [...facts.axes, {low: -0.5, high: 0.5, cells: 1}].slice(0, 2);

/** Unpack something once. */
function chunk(name) {
  if (!state.chunks.has(name)) state.chunks.set(name, unpack(name));
  return state.chunks.get(name);
}

/** Read the numbers of all elites. */
async function loadNumbers() {
  state.cells = new Int32Array(await unpack("cells"));
  const values = new Float32Array(await unpack("values"));
  const count = facts.elites;
  state.values = facts.columns.map((_, k) => values.subarray(k * count, (k + 1) * count));
  state.rowOf = new Int32Array(AXES[0].cells * AXES[1].cells).fill(-1);
  state.cells.forEach((cell, row) => { state.rowOf[cell] = row; });
  if (facts.runs) state.runs = new Float32Array(await unpack("runs"));
}

/** Bytes that so many tiles take. */
function bytesOf(tiles) {
  return Math.ceil(tiles * facts.bits / 8);
}

/** Read tiles out of bytes that hold several each, the first in the lowest bits. */
function readTiles(bytes, offset, count) {
  const tiles = new Uint8Array(count);
  const each = 8 / facts.bits;
  const mask = (1 << facts.bits) - 1;
  for (let k = 0; k < count; k++) {
    tiles[k] = (bytes[offset + Math.floor(k / each)] >> (facts.bits * (k % each))) & mask;
  }
  return tiles;
}

/** Find the layout of an elite after the repair and before. */
async function layoutsOf(row) {
  const number = Math.floor(row / facts.chunk);
  const bytes = new Uint8Array(await chunk(`layouts-${number}`));
  const here = (row - number * facts.chunk) * bytesOf(AREA);
  const repaired = readTiles(bytes, here, AREA);
  const change = readTiles(bytes, bytes.length / 2 + here, AREA);
  const kinds = facts.tiles.length;
  return {repaired, drawn: repaired.map((tile, k) => (tile + change[k]) % kinds)};
}

/** Find how an elite grew: its frames from the seed on; null where the page does not hold them. */
async function growthOf(row) {
  const place = state.grownAt.get(row);
  if (place === undefined) return null;
  const number = Math.floor(place / facts.growth.chunk);
  const bytes = new Uint8Array(await chunk(`growth-${number}`));
  const length = (facts.growth.steps + 1) * AREA;
  const tiles = readTiles(bytes, (place % facts.growth.chunk) * bytesOf(length), length);
  return Array.from({length: facts.growth.steps + 1}, (_, k) => tiles.subarray(k * AREA, (k + 1) * AREA));
}

/** Unpack layouts that nobody asked for yet, while nothing else is to be done. */
async function prefetch() {
  for (let number = 0; number * facts.chunk < facts.elites; number++) {
    await new Promise((resolve) => setTimeout(resolve, 20));
    await chunk(`layouts-${number}`);
  }
}

/** Indices of an elite's cell along each measure. */
function placeOf(row) {
  const [cell, tall] = [state.cells[row], AXES[1].cells];
  return [Math.floor(cell / tall), cell % tall];
}

/** Name a cell as the option --elite takes it. */
function cellText(row) {
  return placeOf(row).slice(0, facts.axes.length).join(",");
}

/** Name an elite as people do: its name, if it has one, and its cell. */
function nameOf(row) {
  const named = facts.named.find((one) => one.row === row);
  return `${named ? `${named.name}, ` : ""}cell ${cellText(row)}`;
}

/** Write a number of a column as people read it. */
function written(value, form) {
  if (!Number.isFinite(value)) return "\u2013";
  if (form === "share") return `${(100 * value).toFixed(1)} %`;
  if (form === "whole") return String(Math.round(value));
  return Math.abs(value) >= 1000 ? value.toFixed(0) : String(Number(value.toPrecision(4)));
}

/** Count the simulations of each elite that are shown one by one. */
function runsOf(row) {
  const count = facts.runs.count;
  return [...state.runs.subarray(row * count, (row + 1) * count)].filter(Number.isFinite);
}

/** Mean of some runs and half of its 95 % interval. */
function meanOf(runs) {
  const mean = runs.reduce((sum, one) => sum + one, 0) / runs.length;
  const squares = runs.reduce((sum, one) => sum + (one - mean) ** 2, 0);
  return {mean, half: runs.length > 1 ? facts.runs.factor * Math.sqrt(squares / (runs.length - 1)) : 0};
}
