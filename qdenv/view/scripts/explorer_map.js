"use strict";

const FONT = {family: "system-ui, -apple-system, Segoe UI, Arial, sans-serif", size: 12, color: "#222"};
const EMPTY = "#f2f2f2"; // cells without an elite
const OUTLIERS = 0.02; // share of the elites at either end
const FEW = 60; // elites that are drawn as squares one can see, however small their cells are
const SQUARE = 9; // pixels

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
  const [first, second] = AXES;
  const grid = Array.from({length: second.cells}, () => new Array(first.cells).fill(null));
  const values = state.values[column];
  for (let row = 0; row < values.length; row++) {
    const [i, j] = placeOf(row);
    grid[j][i] = Number.isFinite(values[row]) ? values[row] : null;
  }
  return grid;
}

/** Describe an axis of the map. */
function axisOf(axis) {
  const plain = {showgrid: false, zeroline: false};
  if (!axis) return {...plain, range: [-0.5, 0.5], visible: false, fixedrange: true};
  const look = {ticks: "outside", ticklen: 4, tickcolor: "#999", linecolor: "#999", mirror: true, showline: true};
  return {...plain, ...look, range: [axis.low, axis.high], title: {text: axis.name, standoff: 8}};
}

/** Middles of the cells along an axis. */
function middles(axis) {
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

/** The elites as squares, where there are few. */
function squares() {
  if (facts.elites > FEW) return [];
  const [x, y] = AXES.map(middles).map((middle, k) =>
    Array.from({length: facts.elites}, (_, row) => middle[placeOf(row)[k]]));
  return [{type: "scatter", mode: "markers", x, y, hoverinfo: "skip", marker: square()}];
}

/** The look of the squares. */
function square() {
  const [cmin, cmax] = colourRange(state.colour);
  return {symbol: "square", size: SQUARE, color: [...state.values[state.colour]], cmin, cmax, colorscale: scale()};
}

/** The colours, each with its place between 0 and 1. */
function scale() {
  return facts.scale.map((colour, k, all) => [k / (all.length - 1), colour]);
}

/** Draw the map with its axes, in place of the sketch. */
async function drawMap() {
  const [first, second] = facts.axes;
  const [zmin, zmax] = colourRange(state.colour);
  const trace = {
    type: "heatmap", x: middles(AXES[0]), y: middles(AXES[1]), z: gridOf(state.colour), zmin, zmax,
    colorscale: scale(), hoverinfo: "skip", colorbar: colourBar(state.colour), zsmooth: false,
  };
  const layout = {
    margin: MARGIN, font: FONT, plot_bgcolor: EMPTY, paper_bgcolor: "#fff",
    xaxis: axisOf(first), yaxis: axisOf(second), dragmode: "zoom",
  };
  await Plotly.newPlot("plot", [trace, ...squares()], layout, {displayModeBar: false, responsive: true, doubleClick: "reset"});
  byId("plot").on("plotly_afterplot", placeMarkers);
  byId("sketch").remove();
}

/** Colour the map by another column. */
async function recolour(column) {
  state.colour = column;
  byId("range").textContent = rangeNote(column);
  showStatus();
  if (!isPlotted()) return drawSketch();
  const [zmin, zmax] = colourRange(column);
  await Plotly.restyle("plot", {z: [gridOf(column)], zmin, zmax, colorbar: colourBar(column)}, [0]);
  if (facts.elites <= FEW) await Plotly.restyle("plot", {marker: [square()]}, [1]);
}
