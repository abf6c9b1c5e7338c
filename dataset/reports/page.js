"use strict";
for (const gallery of document.querySelectorAll(".gallery")) {
  const selects = [...gallery.querySelectorAll("select[data-facet]")];
  const tiles = [...gallery.querySelectorAll(".tile")];
  const order = gallery.querySelector(".order");
  const update = () => {
    for (const tile of tiles) {
      const values = (s) => (tile.getAttribute("data-" + s.dataset.facet) || "").split("\n");
      tile.hidden = selects.some((s) => s.value && !values(s).includes(s.value));
    }
    const shown = tiles.filter((tile) => !tile.hidden);
    gallery.querySelector(".shown").textContent = shown.length + " of " + tiles.length + " shown";
    const by = order ? order.value : "", sign = by[0] === "-" ? -1 : 1;
    const number = (tile) => sign * parseFloat(tile.getAttribute("data-by-" + by.slice(1)));
    const known = tiles.filter((tile) => !isNaN(number(tile))).sort((a, b) => number(a) - number(b));
    gallery.querySelector(".tiles").append(...known, ...tiles.filter((tile) => isNaN(number(tile))));
  };
  gallery.addEventListener("change", update);
  gallery.querySelector(".clear").addEventListener("click", () => {
    for (const select of selects) select.value = "";
    update();
  });
  for (const button of document.querySelectorAll(".choose")) {
    button.addEventListener("click", () => {
      for (const select of selects) {
        const wanted = button.getAttribute("data-set-" + select.dataset.facet) || "";
        select.value = [...select.options].some((option) => option.value === wanted) ? wanted : "";
      }
      update();
      gallery.scrollIntoView({ behavior: "instant", block: "start" });
    });
  }
  update();  // a reloaded page keeps what was chosen
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
