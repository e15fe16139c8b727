"use strict";
function place(input) { input.parentElement.style.setProperty("--at", input.value + "%"); }
document.addEventListener("input", (event) => {
  if (event.target.matches(".slider input")) place(event.target);
});
// Browsers may restore where sliders stood.
for (const input of document.querySelectorAll(".slider input")) place(input);
// An image enlarges on a click, a slider by its button. A click or Escape closes it.
document.documentElement.classList.add("js");
const box = document.createElement("dialog");
box.className = "box";
document.body.append(box);
document.addEventListener("click", (event) => {
  if (event.target.closest(".box")) {
    if (!event.target.matches("input")) box.close();
    return;
  }
  if (!event.target.matches("figure > img") && !event.target.closest(".enlarge")) return;
  const figure = event.target.closest("figure");
  const image = figure.querySelector("img");
  const copy = figure.cloneNode(true);
  const [from, to] = [figure, copy].map((f) => f.querySelector("input"));
  if (to) to.value = from.value;
  box.style.setProperty("--ratio", image.getAttribute("width") / image.getAttribute("height"));
  box.replaceChildren(copy);
  box.showModal();
});
