"use strict";

const STILL = 4; // pixels that a click may move

const ARROWS = {ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1]};

/** Point at an elite: show it where something is free. */
function pointAt(row) {
  if (row === state.pointed) return;
  state.pointed = row;
  placeMarkers();
  showStatus();
  showCards();
}

/** Pin an elite into the first free place, or in place of B; unpin it where it is pinned. */
function togglePin(row) {
  const pinned = state.pins.indexOf(row);
  const free = state.pins.indexOf(null);
  const place = pinned >= 0 ? pinned : free >= 0 ? free : 1;
  state.pins[place] = pinned >= 0 ? null : row;
  if (pinned < 0) state.focus = place;
  hidePreview();
  placeMarkers();
  showStatus();
  showCards();
}

/** Say in a line what is pointed at, or what to do. */
function showStatus() {
  const row = state.pointed;
  if (row === null) {
    byId("status").textContent = "Point at a cell to see its layout. A click pins it, a second click on it lets it go. Drag to zoom, double click to see all again.";
    return;
  }
  const shown = [...facts.axes.keys(), state.colour].map((k) => {
    const {label, form} = facts.columns[k];
    return `${label} ${written(state.values[k][row], form)}`;
  });
  byId("status").textContent = `${nameOf(row)}: ${shown.join(", ")}`;
}

/** Find the nearest filled cell in a direction, straight ahead before aside. */
function nextRow(from, [dx, dy]) {
  const [x, y] = placeOf(from);
  let [best, least] = [from, Infinity];
  for (let row = 0; row < facts.elites; row++) {
    const [i, j] = placeOf(row);
    const ahead = (i - x) * dx + (j - y) * dy;
    const aside = Math.abs((i - x) * dy) + Math.abs((j - y) * dx);
    const away = ahead + 3 * aside;
    if (ahead > 0 && aside <= 2 * ahead && away < least) [best, least] = [row, away];
  }
  return best;
}

/** Answer the keyboard on the map. */
function onKey(event) {
  if (event.altKey || event.ctrlKey || event.metaKey) return;
  const from = state.pointed ?? state.pins[0] ?? state.pins[1] ?? facts.named[0].row;
  if (event.key in ARROWS) pointAt(nextRow(from, ARROWS[event.key]));
  else if (event.key === "Enter") togglePin(from);
  else return;
  event.preventDefault();
}

/** Follow the mouse over the map. */
function onMove(event) {
  const row = event.buttons ? null : rowAt(event.clientX, event.clientY);
  if (row === null) return hidePreview();
  pointAt(row);
  showPreview(row, event.clientX, event.clientY);
}

/** Follow clicks on the map: those that drag nothing. Plotly keeps clicks to itself. */
function listenToMap() {
  const map = byId("map");
  let began = null;
  map.addEventListener("keydown", onKey);
  map.addEventListener("mousemove", onMove);
  map.addEventListener("mouseleave", hidePreview);
  map.addEventListener("mousedown", (event) => { began = event; }, true);
  document.addEventListener("mouseup", (event) => {
    const start = began;
    began = null;
    if (!start || event.button !== 0) return;
    if (Math.hypot(event.clientX - start.clientX, event.clientY - start.clientY) > STILL) return;
    const row = rowAt(event.clientX, event.clientY);
    if (row === null) return;
    state.pointed = row;
    togglePin(row);
  }, true);
}

/** Show a layout beside the pointer while both places hold pins. */
async function showPreview(row, x, y) {
  if (state.pins.includes(null) || state.pins.includes(row)) return hidePreview();
  const {repaired} = await layoutsOf(row);
  if (state.pointed !== row || state.pins.includes(null)) return;
  const preview = byId("preview");
  drawLayout(preview.firstElementChild, repaired);
  preview.firstElementChild.style.width = "100%";
  const {label, form} = facts.columns[state.colour];
  preview.lastElementChild.textContent = `${nameOf(row)}: ${label} ${written(state.values[state.colour][row], form)}`;
  preview.dataset.row = row;
  preview.hidden = false;
  preview.style.left = `${Math.min(x + 18, innerWidth - 200)}px`;
  preview.style.top = `${Math.max(4, Math.min(y + 18, innerHeight - preview.offsetHeight - 4))}px`;
}

/** Take that layout away. */
function hidePreview() {
  byId("preview").hidden = true;
}
