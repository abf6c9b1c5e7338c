"use strict";
for (const gallery of document.querySelectorAll(".gallery")) {
  const selects = [...gallery.querySelectorAll("select")], tiles = [...gallery.querySelectorAll(".tile")];
  const values = new Map(tiles.map((tile) => [tile, JSON.parse(tile.dataset.values)]));
  const update = () => {
    for (const tile of tiles) {
      tile.hidden = selects.some((s) => s.value && !values.get(tile)[s.dataset.facet].includes(s.value));
    }
    const shown = tiles.filter((tile) => !tile.hidden).length;
    gallery.querySelector(".shown").textContent = shown + " of " + tiles.length + " shown";
  };
  gallery.addEventListener("change", update);
  update();  // a reloaded page keeps what was chosen
}
