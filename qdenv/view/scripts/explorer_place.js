"use strict";

const REACH = 10; // pixels from the pointer in which the nearest elite counts

/** Tell whether the library has drawn the map, or a sketch still stands in for it. */
function isPlotted() {
  return Boolean(byId("plot")._fullLayout?.xaxis?.d2p);
}

/** The two axes as they are drawn now: where they begin, how long they are, values to pixels and back. */
function drawnAxes() {
  if (!isPlotted()) return sketchedAxes();
  const {xaxis, yaxis} = byId("plot")._fullLayout;
  return [xaxis, yaxis].map((axis) => ({
    offset: axis._offset, length: axis._length, pixels: (value) => axis.d2p(value), value: (pixel) => axis.p2d(pixel),
  }));
}

/** Pixels of the middle of an elite's cell, from the top left of the map. */
function pixelsOf(row) {
  return drawnAxes().map((axis, k) => {
    const {low, high, cells} = AXES[k];
    return axis.offset + axis.pixels(low + (placeOf(row)[k] + 0.5) * (high - low) / cells);
  });
}

/** Pixels of a cell's width and height. */
function cellPixels() {
  return drawnAxes().map((axis, k) => {
    const {low, high, cells} = AXES[k];
    return Math.abs(axis.pixels((high - low) / cells) - axis.pixels(0));
  });
}

/** Find the elite under the pointer, or the nearest one within reach; null for none. */
function rowAt(clientX, clientY) {
  const box = byId("plot").getBoundingClientRect();
  const place = drawnAxes().map((axis, k) => {
    const along = facts.axes[k];
    const value = axis.value((k ? clientY - box.top : clientX - box.left) - axis.offset);
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
  const [wide, tall] = AXES.map((axis) => axis.cells);
  return i < 0 || j < 0 || i >= wide || j >= tall ? -1 : state.rowOf[i * tall + j];
}

/** Put the marks of A, B and the pointed cell where their cells are drawn now. */
function placeMarkers() {
  const rows = [state.pointed, ...state.pins];
  document.querySelectorAll(".marker").forEach((marker, k) => placeMarker(marker, rows[k]));
}

/** Put one mark onto an elite's cell; out of sight where the map is zoomed away from it. */
function placeMarker(marker, row) {
  marker.hidden = true;
  if (row === null) return;
  const place = pixelsOf(row);
  const inside = drawnAxes().every((axis, k) => place[k] >= axis.offset && place[k] <= axis.offset + axis.length);
  if (!inside) return;
  const [wide, tall] = cellPixels();
  marker.style.left = `${place[0]}px`;
  marker.style.top = `${place[1]}px`;
  marker.style.width = `${Math.max(9, wide + 4)}px`;
  marker.style.height = `${Math.max(9, tall + 4)}px`;
  marker.hidden = false;
}
