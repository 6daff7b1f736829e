"use strict";

// On the page of elites with guidance only: whatever draws a card draws arrows onto its layout.
const [bareLayoutsOf, drawBareCard] = [layoutsOf, drawCard];

layoutsOf = async (row) => {
  const number = Math.floor(row / facts.chunk);
  const bytes = new Uint8Array(await chunk(`arrows-${number}`));
  const here = (row - number * facts.chunk) * AREA;
  return {...await bareLayoutsOf(row), arrows: bytes.subarray(here, here + AREA)};
};

drawCard = (card, layouts, paled) => {
  drawBareCard(card, layouts, paled);
  if (!layouts || !byId("guidance").checked) return;
  const canvas = card.querySelector("canvas");
  drawArrows(canvas.getContext("2d"), layouts.arrows, 0, 0, canvas.width / facts.cols);
};

byId("guidance").addEventListener("change", () => {
  CARDS.forEach((card) => { card.dataset.drawing = ""; });
  showCards();
});
