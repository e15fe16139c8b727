"use strict";
const all = (query, root = document) => [...root.querySelectorAll(query)];
const clear = (...names) => names.forEach((name) => all("." + name).forEach((e) => {
  if (name !== "in" && name !== "out" || e.tagName === "path") e.classList.remove(name);
}));
const mark = (query, name) => all(query).forEach((e) => e.classList.add(name));

// Highlights a pass, its dependencies and its dependents.
function showPass(element) {
  const pass = element.dataset.pass || element.parentElement.dataset.pass;
  mark(`[data-pass="${pass}"]`, "hot");
  mark(`.arcs path[data-to="${pass}"]`, "in");
  mark(`.arcs path[data-from="${pass}"]`, "out");
  const numbers = (text) => (text || "").split(" ").filter(Boolean);
  numbers(element.dataset.in).forEach((n) => mark(`[data-pass="${n}"]`, "follows"));
  numbers(element.dataset.out).forEach((n) => mark(`[data-pass="${n}"]`, "after"));
}

// Highlights a buffer wherever it appears, and every pass that accesses it.
function showBuffer(element) {
  const buffer = element.dataset.buffer;
  mark(`[data-buffer="${buffer}"]`, "hot");
  all(`article .chip[data-buffer="${buffer}"]`).forEach((chip) => {
    const pass = chip.closest("article").dataset.pass;
    mark(`#map li[data-pass="${pass}"]`, "touch");
  });
}

document.addEventListener("mouseover", (event) => {
  clear("hot", "follows", "after", "touch", "in", "out");
  const buffer = event.target.closest("[data-buffer]");
  const pass = event.target.closest("#map li a, article");
  if (buffer) showBuffer(buffer);
  else if (pass) showPass(pass);
});

const search = document.getElementById("search");
const found = document.getElementById("found");
search.addEventListener("input", () => {
  const words = search.value.toLowerCase().split(/\s+/).filter(Boolean);
  let passes = 0, buffers = 0;
  all("[data-find]").forEach((e) => {
    const text = e.dataset.find.toLowerCase();
    const hit = words.every((word) => text.includes(word));
    e.classList.toggle("miss", !hit);
    if (hit && e.tagName === "ARTICLE") passes += 1;
    if (hit && e.tagName === "TR") buffers += 1;
  });
  // The map follows the matches of the cards, buffer names included.
  all("#map li").forEach((line) => {
    const card = document.getElementById("p" + line.dataset.pass);
    line.classList.toggle("miss", card !== null && card.classList.contains("miss"));
  });
  all(".group").forEach((group) => {
    const cards = all("article", group);
    group.hidden = words.length > 0 && (cards.length === 0 || cards.every((card) => card.classList.contains("miss")));
  });
  found.textContent = words.length ? `${passes} passes, ${buffers} buffers` : "";
});

document.getElementById("theme").addEventListener("click", () => {
  const root = document.documentElement;
  const dark = root.dataset.theme ? root.dataset.theme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
  root.dataset.theme = dark ? "light" : "dark";
});
