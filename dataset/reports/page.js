"use strict";
for (const gallery of document.querySelectorAll(".gallery")) {
  const selects = [...gallery.querySelectorAll("select[data-facet]")];
  const tiles = [...gallery.querySelectorAll(".tile")];
  const order = gallery.querySelector(".order");
  const overlays = gallery.querySelector(".overlays");
  const filter = () => {
    let shown = 0;
    for (const tile of tiles) {
      const values = (s) => (tile.getAttribute("data-" + s.dataset.facet) || "").split("\n");
      const fits = selects.every((s) => !s.value || values(s).includes(s.value));
      tile.hidden = !fits;
      shown += fits;
    }
    gallery.querySelector(".shown").textContent = shown + " of " + tiles.length + " shown";
  };
  const sort = () => {
    if (!order) return;
    const sign = order.value[0] === "-" ? -1 : 1;
    const number = (tile) => sign * parseFloat(tile.getAttribute("data-by-" + order.value.slice(1)));
    const place = (tile, i) => (!order.value ? i : isNaN(number(tile)) ? Infinity : number(tile));
    const places = new Map(tiles.map((tile, i) => [tile, place(tile, i)]));
    const sorted = [...tiles].sort((a, b) => (places.get(a) > places.get(b)) - (places.get(a) < places.get(b)));
    gallery.querySelector(".tiles").append(...sorted);
  };
  const overlay = () => document.body.classList.toggle("bare", !overlays.checked);
  for (const select of selects) select.addEventListener("change", filter);
  if (order) order.addEventListener("change", sort);
  if (overlays) overlays.addEventListener("change", overlay);
  gallery.querySelector(".clear").addEventListener("click", () => {
    for (const select of selects) select.value = "";
    filter();
  });
  for (const button of document.querySelectorAll(".choose")) {
    button.addEventListener("click", () => {
      for (const select of selects) {
        const wanted = button.getAttribute("data-set-" + select.dataset.facet) || "";
        select.value = [...select.options].some((option) => option.value === wanted) ? wanted : "";
      }
      filter();
      gallery.scrollIntoView({ behavior: "instant", block: "start" });
    });
  }
  filter();  // a reloaded page keeps what was chosen
  sort();
  if (overlays) overlay();
}
const dialog = document.querySelector("dialog");
let large = null;  // the thumbnail that is shown large
const show = (tile) => {
  large = tile;
  dialog.querySelector(".frame").innerHTML = tile.querySelector(".frame").innerHTML;
  dialog.querySelector("p").textContent = [...tile.querySelectorAll("strong, .line")].map((e) => e.textContent).join("\n");
};
for (const tile of document.querySelectorAll(".tile")) {
  tile.addEventListener("click", () => {
    show(tile);
    dialog.showModal();
  });
}
dialog.querySelector("button").addEventListener("click", () => dialog.close());
dialog.addEventListener("close", () => large.focus());
dialog.addEventListener("keydown", (event) => {
  const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
  if (step) {
    const shown = [...large.parentElement.children].filter((tile) => !tile.hidden);
    show(shown[Math.min(Math.max(shown.indexOf(large) + step, 0), shown.length - 1)]);
  }
});
