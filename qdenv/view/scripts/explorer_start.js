"use strict";

/** Offer every column as colours of the map. */
function offerColours() {
  const choice = byId("colour");
  facts.columns.forEach((column, k) => {
    if (k >= facts.axes.length) choice.add(new Option(column.label, k, false, k === state.colour));
  });
  choice.addEventListener("change", () => recolour(Number(choice.value)));
}

/** Offer the elites that have names. */
function offerNames() {
  const choice = byId("named");
  choice.add(new Option("\u2026", ""));
  for (const {name, row} of facts.named) choice.add(new Option(name, row));
  choice.addEventListener("change", () => {
    const row = Number(choice.value);
    if (choice.value !== "" && !state.pins.includes(row)) togglePin(row);
    choice.value = "";
  });
}

/** Show a sketch of the map and the best elite at once, then what takes longer. */
async function start() {
  await loadNumbers();
  byId("map").classList.toggle("strip", facts.axes.length === 1);
  drawSketch();
  state.pins[0] = facts.named[0].row;
  placeMarkers();
  showStatus();
  byId("range").textContent = rangeNote(state.colour);
  offerColours();
  offerNames();
  drawLegend();
  listenToMap();
  listenToCards();
  listenToGrowth();
  await showCards();
  await new Promise((done) => requestAnimationFrame(() => setTimeout(done))); // the sketch can be seen
  performance.mark("sketched");
  await loadPlotly();
  await drawMap();
  placeMarkers();
  performance.mark("drawn");
  document.body.dataset.ready = "yes";
  prefetch();
}

start();
