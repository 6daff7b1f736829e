"use strict";

const ARROW = [[0.5, 0], [-0.13, -0.32], [-0.13, -0.11], [-0.5, -0.11], [-0.5, 0.11], [-0.13, 0.11], [-0.13, 0.32]];
const [NO_ARROW, LONGEST_ARROW] = [8, 7]; // of half a byte; levels of strength, there and back

/**
 * Draw arrows between cells, as `draw_arrows` in `qdenv/view/guidance.py` does.
 * bytes: Uint8Array of rows * cols, the arrow to the cell at the right in the upper half of each,
 * to the one below in the lower; x, y: corner of the layout and size: of a cell, in pixels.
 */
function drawArrows(pen, bytes, x, y, size) {
  bytes.forEach((both, cell) => {
    const [column, row] = [cell % facts.cols, Math.floor(cell / facts.cols)];
    drawArrow(pen, (both >> 4) - NO_ARROW, 0, x + (column + 1) * size, y + (row + 0.5) * size, size);
    drawArrow(pen, (both & 15) - NO_ARROW, 1, x + (column + 0.5) * size, y + (row + 1) * size, size);
  });
  pen.globalAlpha = 1;
}

/** Draw an arrow around a point: to the right (axis 0) or down (axis 1), or back if the level is below 0. */
function drawArrow(pen, level, axis, x, y, size) {
  if (!level) return;
  const strength = Math.abs(level) / LONGEST_ARROW;
  const length = Math.sign(level) * (0.45 + 0.45 * strength) * size;
  pen.beginPath();
  for (const [along, aside] of ARROW) {
    const [far, wide] = [along * length, aside * size];
    pen.lineTo(...(axis ? [x + wide, y + far] : [x + far, y + wide]));
  }
  pen.fillStyle = facts.arrows[2 * axis + (level < 0)];
  pen.globalAlpha = 0.3 + 0.7 * strength;
  pen.fill();
}
