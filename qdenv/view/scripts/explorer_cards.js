"use strict";

const CARDS = [byId("card-0"), byId("card-1")];

/** Which elites A and B show: what is pinned, and in the first free place what is pointed at. */
function shownRows() {
  const free = state.pins.indexOf(null);
  return state.pins.map((row, place) => (place === free ? state.pointed : row));
}

/** Show A and B with their numbers, and the growth of one of them. */
async function showCards() {
  const rows = shownRows();
  const layouts = await Promise.all(rows.map((row) => (row === null ? null : layoutsOf(row))));
  const now = shownRows();
  if (rows.some((row, place) => row !== now[place])) return; // pointed elsewhere meanwhile
  const [one, other] = layouts;
  const same = one && other ? alike(one.repaired, other.repaired) : [];
  const paled = byId("differences").checked && !state.pins.includes(null) ? same : [];
  CARDS.forEach((card, place) => {
    showCard(card, place, rows[place]);
    const drawing = `${rows[place]},${paled.length ? rows[1 - place] : ""}`; // what else is drawn already
    if (card.dataset.drawing !== drawing) drawCard(card, layouts[place], paled);
    card.dataset.drawing = drawing;
    const canvas = card.querySelector("canvas");
    if (canvas.dataset.row !== String(rows[place])) card.querySelector("output").textContent = "";
    canvas.dataset.row = String(rows[place]);
  });
  byId("differing").textContent = one && other ? `${AREA - same.length} of ${AREA} cells differ` : "";
  showTable(rows);
  showGrowth(rows);
}

/** Say which elite a card shows, and what can be done with it. */
function showCard(card, place, row) {
  const pinned = state.pins[place] !== null;
  card.querySelector("h2").textContent = row === null ? "" : nameOf(row);
  card.querySelector("header .faint").textContent = row === null ? "" : pinned ? "pinned" : "click pins it";
  card.querySelector(".sheet p").hidden = row !== null;
  card.querySelector(".pin").textContent = pinned ? "Unpin" : "Pin";
  card.querySelectorAll("button").forEach((button) => { button.disabled = row === null; });
  card.querySelector("canvas").setAttribute("aria-label", row === null ? "empty" : `layout of ${nameOf(row)}`);
}

/** Draw the layout of a card. */
function drawCard(card, layouts, paled) {
  const canvas = card.querySelector("canvas");
  if (layouts) drawLayout(canvas, layouts.repaired, [], paled);
  else canvas.getContext("2d").clearRect(0, 0, canvas.width, canvas.height);
}

/** The content of a layout file, as qdenv writes it. */
function layoutFile(row, tiles) {
  const lines = Array.from({length: facts.rows}, (_, r) =>
    Array.from(tiles.subarray(r * facts.cols, (r + 1) * facts.cols), (tile) => facts.tiles[tile]).join(""));
  const number = (k) => Number(state.values[k][row].toPrecision(7));
  const measures = Object.fromEntries(facts.axes.map((axis, k) => [axis.name, number(k)]));
  const known = {elite: cellText(row), objective: number(facts.axes.length), measures};
  return JSON.stringify({n_row: facts.rows, n_col: facts.cols, ...facts.details, ...known, layout: lines}, null, 1);
}

/** Save an elite's layout as a file. */
async function saveLayout(row) {
  const {repaired} = await layoutsOf(row);
  saveText(`${facts.details.domain}_${cellText(row).replace(",", "_")}.json`, `${layoutFile(row, repaired)}\n`);
}

/** The command line that makes an elite's layout again. */
function commandOf(row) {
  return facts.command + cellText(row);
}

/** Copy that command line and show it. */
async function copyCommand(card, row) {
  const command = commandOf(row);
  const shown = element("code", command);
  const output = card.querySelector("output");
  output.replaceChildren(shown);
  output.title = command;
  getSelection().selectAllChildren(shown);
  try {
    await navigator.clipboard.writeText(command);
  } catch {
    document.execCommand("copy"); // inside of notebooks the clipboard is closed
  }
  output.prepend("copied: ");
}

/** Let the buttons of A and B work. */
function listenToCards() {
  CARDS.forEach((card, place) => {
    const on = (kind, act) => card.querySelector(kind).addEventListener("click", () => act(shownRows()[place]));
    on(".pin", togglePin);
    on(".save", saveLayout);
    on(".copy", (row) => copyCommand(card, row));
  });
  byId("differences").addEventListener("change", showCards);
}
