// A page that a server keeps up to date: parts are taken over as they change, sliders stay where they are.
let images = 0;
let unanswered = 0;
function take(id, html) {
  const part = document.querySelector("#" + id + " .live");
  if (!part || part.dataset.html === html) return;
  const stood = [...part.querySelectorAll(".slider input")].map((input) => input.value);
  part.innerHTML = html;
  part.dataset.html = html;
  part.querySelectorAll(".slider input").forEach((input, i) => {
    if (i < stood.length) input.value = stood[i];
    place(input);
  });
}
async function look() {
  try {
    if (!document.hidden) {
      const answer = await fetch("live?images=" + images, { cache: "no-store" });
      if (!answer.ok) throw new Error(answer.status);
      const now = await answer.json();
      for (const [id, html] of Object.entries(now.parts)) take(id, html);
      images = now.images;
      unanswered = 0;
      if (now.ended) {
        // Nobody answers any more.
        document.body.classList.add("finished");
        return;
      }
    }
    setTimeout(look, 2000);
  } catch {
    // A busy server turns some away.
    unanswered += 1;
    if (unanswered < 3) setTimeout(look, 2000);
    else document.body.classList.add("ended");
  }
}
look();
