"use strict";

const FONT = {family: "system-ui, -apple-system, Segoe UI, Arial, sans-serif", size: 12, color: "#222"};
const EMPTY = "#f2f2f2"; // cells without an elite
const OUTLIERS = 0.02; // share of the elites at either end
const REACH = 10; // pixels from the pointer in which the nearest elite counts

/** Run the library that draws the map. As a file of its own it is read beside all else. */
async function loadPlotly() {
  const code = new Blob([await unpack("plotly")], {type: "text/javascript"});
  const script = document.createElement("script");
  script.src = URL.createObjectURL(code);
  await new Promise((done, failed) => {
    script.onload = done;
    script.onerror = failed;
    document.head.append(script);
  });
  URL.revokeObjectURL(script.src);
}

/** Lay the numbers of a column out as rows of the map, null where there is no elite. */
function gridOf(column) {
  const [first, second] = facts.axes;
  const grid = Array.from({length: second ? second.cells : 1}, () => new Array(first.cells).fill(null));
  const values = state.values[column];
  for (let row = 0; row < values.length; row++) {
    const [i, j] = placeOf(row);
    grid[j][i] = Number.isFinite(values[row]) ? values[row] : null;
  }
  return grid;
}

/** Describe an axis of the map. */
function axisOf(axis) {
  const plain = {showgrid: false, zeroline: false, automargin: true};
  if (!axis) return {...plain, range: [-0.5, 0.5], visible: false, fixedrange: true};
  const look = {ticks: "outside", ticklen: 4, tickcolor: "#999", linecolor: "#999", mirror: true, showline: true};
  return {...plain, ...look, range: [axis.low, axis.high], title: {text: axis.name, standoff: 8}};
}

/** Middles of the cells along an axis. */
function middles(axis) {
  if (!axis) return [0];
  const width = (axis.high - axis.low) / axis.cells;
  return Array.from({length: axis.cells}, (_, k) => axis.low + (k + 0.5) * width);
}

/**
 * Lower and upper end of the colours. A few outliers share the outermost colour where they would
 * take half of the scale.
 */
function colourRange(column) {
  const sorted = state.values[column].filter(Number.isFinite).sort();
  if (!sorted.length) return [0, 1];
  const at = (share) => sorted[Math.round(share * (sorted.length - 1))];
  const [low, high] = [at(0), at(1)];
  const [few, most] = [at(OUTLIERS), at(1 - OUTLIERS)];
  if (low === high) return [low - 0.5, high + 0.5];
  const half = (high - low) / 2;
  return [most > few && few - low > half ? few : low, most > few && high - most > half ? most : high];
}

/** Say where the colours end before the numbers do. */
function rangeNote(column) {
  const [low, high] = colourRange(column);
  const {form} = facts.columns[column];
  const values = state.values[column];
  const notes = [];
  if (values.some((value) => value < low)) notes.push(`darkest: ${written(low, form)} or less`);
  if (values.some((value) => value > high)) notes.push(`brightest: ${written(high, form)} or more`);
  return notes.join(", ");
}

/** Say how the colour bar writes the numbers of a column. */
function colourBar(column) {
  const form = facts.columns[column].form === "share" ? ".0%" : "";
  return {thickness: 14, outlinewidth: 0, tickformat: form, ypad: 0, xpad: 8};
}

/** Draw the map. */
async function drawMap() {
  const [first, second] = facts.axes;
  byId("map").classList.toggle("strip", !second);
  const [zmin, zmax] = colourRange(state.colour);
  const trace = {
    type: "heatmap", x: middles(first), y: middles(second), z: gridOf(state.colour), zmin, zmax,
    colorscale: "Viridis", hoverinfo: "skip", colorbar: colourBar(state.colour), zsmooth: false,
  };
  const layout = {
    margin: {l: 8, r: 8, t: 8, b: 8}, font: FONT, plot_bgcolor: EMPTY, paper_bgcolor: "#fff",
    xaxis: axisOf(first), yaxis: axisOf(second), dragmode: "zoom",
  };
  await Plotly.newPlot("plot", [trace], layout, {displayModeBar: false, responsive: true, doubleClick: "reset"});
  byId("plot").on("plotly_afterplot", placeMarkers);
  byId("range").textContent = rangeNote(state.colour);
}

/** Colour the map by another column. */
async function recolour(column) {
  state.colour = column;
  const [zmin, zmax] = colourRange(column);
  await Plotly.restyle("plot", {z: [gridOf(column)], zmin, zmax, colorbar: colourBar(column)});
  byId("range").textContent = rangeNote(column);
  showStatus();
}

/** The two axes as Plotly draws them now: they turn values into pixels and back. */
function drawnAxes() {
  const {xaxis, yaxis} = byId("plot")._fullLayout;
  return [xaxis, yaxis];
}

/** Pixels of the middle of an elite's cell, from the top left of the map. */
function pixelsOf(row) {
  return drawnAxes().map((axis, k) => {
    const along = facts.axes[k];
    const value = along ? along.low + (placeOf(row)[k] + 0.5) * (along.high - along.low) / along.cells : 0;
    return axis._offset + axis.d2p(value);
  });
}

/** Pixels of a cell's width and height. */
function cellPixels() {
  return drawnAxes().map((axis, k) => {
    const along = facts.axes[k];
    const width = along ? (along.high - along.low) / along.cells : 1;
    return Math.abs(axis.d2p(width) - axis.d2p(0));
  });
}

/** Find the elite under the pointer, or the nearest one within reach; null for none. */
function rowAt(clientX, clientY) {
  const box = byId("plot").getBoundingClientRect();
  const place = drawnAxes().map((axis, k) => {
    const along = facts.axes[k];
    const value = axis.p2d((k ? clientY - box.top : clientX - box.left) - axis._offset);
    return along ? (value - along.low) / (along.high - along.low) * along.cells - 0.5 : 0;
  });
  return nearestRow(place, cellPixels());
}

/** Find the filled cell nearest to a place, given in cells, within reach in pixels. */
function nearestRow(place, pixels) {
  let [best, least] = [null, Infinity];
  const spans = pixels.map((size) => Math.max(1, Math.ceil(REACH / size)));
  const [middleX, middleY] = place.map(Math.round);
  for (let i = middleX - spans[0]; i <= middleX + spans[0]; i++) {
    for (let j = middleY - spans[1]; j <= middleY + spans[1]; j++) {
      const row = rowIn(i, j);
      if (row < 0) continue;
      const away = Math.hypot(...[i - place[0], j - place[1]].map((d, k) => Math.max(0, Math.abs(d) - 0.5) * pixels[k]));
      if (away < least && away <= REACH) [best, least] = [row, away];
    }
  }
  return best;
}

/** The row in a cell, -1 where there is none. */
function rowIn(i, j) {
  const [first, second] = facts.axes;
  const tall = second ? second.cells : 1;
  if (i < 0 || j < 0 || i >= first.cells || j >= tall) return -1;
  return state.rowOf[i * tall + j];
}

/** Put the marks of A, B and the pointed cell where their cells are drawn now. */
function placeMarkers() {
  const rows = [state.pointed, ...state.pins];
  document.querySelectorAll(".marker").forEach((marker, k) => placeMarker(marker, rows[k]));
}

/** Put one mark onto an elite's cell; out of sight where the map is zoomed away from it. */
function placeMarker(marker, row) {
  marker.hidden = true;
  if (row === null || !byId("plot")._fullLayout) return;
  const place = pixelsOf(row);
  const inside = drawnAxes().every((axis, k) => place[k] >= axis._offset && place[k] <= axis._offset + axis._length);
  if (!inside) return;
  const [wide, tall] = cellPixels();
  marker.style.left = `${place[0]}px`;
  marker.style.top = `${place[1]}px`;
  marker.style.width = `${Math.max(9, wide + 4)}px`;
  marker.style.height = `${Math.max(9, tall + 4)}px`;
  marker.hidden = false;
}
