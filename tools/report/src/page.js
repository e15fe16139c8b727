"use strict";
function place(input) { input.parentElement.style.setProperty("--at", input.value + "%"); }
document.addEventListener("input", (event) => {
  if (event.target.matches(".slider input")) place(event.target);
});
// Browsers may restore where sliders stood.
for (const input of document.querySelectorAll(".slider input")) place(input);
