"use strict";

const COLOURS = facts.marks;
const HALO = 1.35; // cells from the middle of a jammed robot to where its halo ends
const TURN = Math.PI / 2;

/** Fill the path that was drawn, and draw its rim. */
function paint(context, fill, rim, width) {
  context.fillStyle = fill;
  context.fill();
  context.strokeStyle = rim;
  context.lineWidth = width;
  context.stroke();
}

/** Fill a disc with a rim. */
function disc(context, x, y, radius, fill, rim, width) {
  context.beginPath();
  context.arc(x, y, radius, 0, 2 * Math.PI);
  paint(context, fill, rim, width);
}

/** Draw a diamond, the mark of a goal. */
function diamond(context, x, y, radius, width) {
  context.beginPath();
  for (let corner = 0; corner < 4; corner++) {
    context.lineTo(x + radius * Math.cos(corner * TURN), y + radius * Math.sin(corner * TURN));
  }
  context.closePath();
  paint(context, "#ffffffb0", COLOURS.goal, width);
}

/** Draw a triangle that points to a heading (0 right, 1 down, 2 left, 3 up). */
function arrow(context, x, y, size, heading) {
  context.save();
  context.translate(x, y);
  context.rotate(heading * TURN);
  context.beginPath();
  for (const [right, down] of [[0.42, 0], [-0.34, -0.36], [-0.18, 0], [-0.34, 0.36]]) {
    context.lineTo(right * size, down * size);
  }
  context.closePath();
  paint(context, COLOURS.agent, COLOURS.ink, Math.max(1, size / 14));
  context.restore();
}

/** Draw a soft halo around a jammed robot, warmer with each level. */
function halo(context, x, y, size, level) {
  const colour = facts.warmth[level];
  const shade = context.createRadialGradient(x, y, 0, x, y, HALO * size);
  shade.addColorStop(0, colour);
  shade.addColorStop(0.55, `${colour}b0`);
  shade.addColorStop(1, `${colour}00`);
  context.fillStyle = shade;
  context.fillRect(x - HALO * size, y - HALO * size, 2 * HALO * size, 2 * HALO * size);
}

// How each thing is drawn in the middle of a cell of `size` pixels.
const MARKS = {
  driving: (context, x, y, size) => disc(context, x, y, 0.38 * size, COLOURS.driving, "#fff", 0.06 * size),
  serving: (context, x, y, size) =>
    disc(context, x, y, 0.31 * size, "#fff", COLOURS.serving, 0.16 * size),
  waiting: (context, x, y, size) => {
    disc(context, x, y, 0.38 * size, COLOURS.waiting, "#fff", 0.06 * size);
    context.fillStyle = "#fff";
    context.fillRect(x - 0.2 * size, y - 0.06 * size, 0.4 * size, 0.12 * size);
  },
  goal: (context, x, y, size) => diamond(context, x, y, 0.4 * size, Math.max(1, 0.1 * size)),
  agent: (context, x, y, size) => arrow(context, x, y, size, 0),
  start: (context, x, y, size) => {
    context.fillStyle = COLOURS.start;
    context.fillRect(x - size / 2, y - size / 2, size, size);
  },
  jam: (context, x, y, size, level) => halo(context, x, y, size / (level === undefined ? 2.7 : 1),
    level ?? 4),
};

/** Find the picture of a mark in cells of a size; it is drawn once, then copied. */
function spriteOf(sprites, kind, size, level) {
  const key = `${kind}${level ?? ""}`;
  if (sprites.size !== size) Object.assign(sprites, {size, pictures: {}});
  if (!sprites.pictures[key]) {
    const side = Math.ceil((kind === "jam" ? 2 * HALO : 1) * size) + 2;
    const picture = document.createElement("canvas");
    picture.width = picture.height = side;
    MARKS[kind](picture.getContext("2d"), side / 2, side / 2, size, level);
    sprites.pictures[key] = picture;
  }
  return sprites.pictures[key];
}
