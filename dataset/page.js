"use strict";
for (const gallery of document.querySelectorAll(".gallery")) {
  const selects = [...gallery.querySelectorAll("select")];
  const tiles = [...gallery.querySelectorAll(".tile")];
  const filter = () => {
    let shown = 0;
    for (const tile of tiles) {
      const fits = selects.every((s) => !s.value || tile.getAttribute("data-" + s.dataset.facet) === s.value);
      tile.hidden = !fits;
      shown += fits;
    }
    gallery.querySelector(".shown").textContent = shown + " of " + tiles.length + " shown";
  };
  for (const select of selects) select.addEventListener("change", filter);
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
}
const dialog = document.querySelector("dialog");
for (const tile of document.querySelectorAll(".tile")) {
  tile.addEventListener("click", () => {
    dialog.querySelector("img").src = tile.querySelector("img").src;
    dialog.querySelector("p").textContent = [...tile.querySelectorAll("strong, span")].map((e) => e.textContent).join("\n");
    dialog.showModal();
  });
}
dialog.querySelector("button").addEventListener("click", () => dialog.close());
