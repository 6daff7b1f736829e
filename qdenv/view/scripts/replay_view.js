"use strict";

const NEAREST = 96; // CSS pixels of a cell, at most

/** Make a view of a layout: `scale` CSS pixels a cell, its corner at `x`, `y` of the stage. */
function makeView(rows, cols) {
  return {rows, cols, width: 1, height: 1, ratio: 1, scale: 1, x: 0, y: 0, whole: true};
}

/** Find the pixel of the canvas at a place (column, row). */
function pixelAt(view, column, row) {
  return [(view.x + column * view.scale) * view.ratio, (view.y + row * view.scale) * view.ratio];
}

/** Choose the scale at which the whole layout fits, of whole pixels of the screen where it can. */
function fitScale(view) {
  const margin = 12;
  const scale = Math.min((view.width - margin) / view.cols, (view.height - margin) / view.rows);
  const pixels = scale * view.ratio;
  return pixels >= 2 ? Math.floor(pixels) / view.ratio : scale;
}

/** Show the whole layout in the middle of the stage. */
function fitView(view) {
  view.scale = fitScale(view);
  view.whole = true;
  view.x = (view.width - view.cols * view.scale) / 2;
  view.y = (view.height - view.rows * view.scale) / 2;
  snapView(view);
}

/** Let the corner lie on a whole pixel of the screen, so that the tiles' edges are sharp. */
function snapView(view) {
  view.x = Math.round(view.x * view.ratio) / view.ratio;
  view.y = Math.round(view.y * view.ratio) / view.ratio;
}

/** Enlarge the view around a point of the stage, which stays where it is. */
function zoomView(view, factor, x = view.width / 2, y = view.height / 2) {
  const scale = Math.min(NEAREST, view.scale * factor);
  if (scale <= fitScale(view)) return fitView(view);
  view.x = x - ((x - view.x) * scale) / view.scale;
  view.y = y - ((y - view.y) * scale) / view.scale;
  view.scale = scale;
  view.whole = false;
  moveView(view, 0, 0);
}

/** Move the view, but never so far that the layout leaves the stage. */
function moveView(view, right, down) {
  const within = (corner, stage, size) =>
    Math.min(Math.max(corner, stage / 2 - size), stage / 2);
  view.x = within(view.x + right, view.width, view.cols * view.scale);
  view.y = within(view.y + down, view.height, view.rows * view.scale);
  snapView(view);
}

/** Keep a place in the middle part of a view that does not show everything. */
function keepInView(view, column, row) {
  if (view.whole) return;
  const part = (place, size) => {
    const margin = size / 5;
    return Math.max(margin - place, 0) + Math.min(size - margin - place, 0);
  };
  const right = part(view.x + column * view.scale, view.width);
  const down = part(view.y + row * view.scale, view.height);
  if (right || down) moveView(view, right, down);
}

/** Give both canvases the stage's size in pixels of the screen. */
function resizeView(view, stage, canvases) {
  view.width = stage.clientWidth;
  view.height = stage.clientHeight;
  view.ratio = window.devicePixelRatio || 1;
  for (const canvas of canvases) {
    canvas.width = Math.round(view.width * view.ratio);
    canvas.height = Math.round(view.height * view.ratio);
  }
  if (view.whole) fitView(view);
  else moveView(view, 0, 0);
}
