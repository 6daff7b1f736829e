"use strict";

// On the page of a floor with guidance only: whatever draws the floor draws arrows onto it.
const drawBareGround = drawGround;
let arrowBytes = null;

drawGround = (canvas, film, ground, view, ...shown) => {
  const before = ground.drawn;
  drawBareGround(canvas, film, ground, view, ...shown);
  if (ground.drawn === before || !arrowBytes || !byId("guidance").checked) return;
  const place = [view.x, view.y, view.scale].map((one) => one * view.ratio);
  drawArrows(canvas.getContext("2d"), arrowBytes, ...place);
};

/** Draw the floor once more. */
function redrawGround() {
  if (!state.film) return; // it will be drawn
  state.ground.drawn = "";
  draw();
}

byId("guidance").addEventListener("change", redrawGround);
numbers("arrows", Uint8Array).then((bytes) => {
  arrowBytes = bytes;
  redrawGround();
});
