"use strict";
const episodes = JSON.parse(document.getElementById("episodes").textContent);
const frame = document.querySelector(".player");
const find = (selector) => document.querySelector(selector);
let steps = [], cursors = [];

/* Creates an element; text is never parsed as HTML. */
function make(tag, attributes, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  element.append(...children);
  return element;
}

/* Runs in the player: its time field is used to seek and to read the time. */
function led(opens) {
  let wanted = opens;
  const field = () => document.querySelector("input[inputmode=decimal]");
  const write = Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, "value").set;
  function seek(input, seconds) {
    write.call(input, seconds.toFixed(2));
    input.dispatchEvent(new Event("input", { bubbles: true }));
  }
  function play(input) {
    let bar = input;
    while (bar && !bar.querySelector("button")) bar = bar.parentElement;
    bar?.querySelector("button").click();
  }
  addEventListener("message", (event) => {
    const input = field();
    if (typeof event.data?.seek !== "number" || !input) return;
    seek(input, event.data.seek);
    // Seeking pauses the player at its next frame, so play again after that.
    setTimeout(() => play(input), 80);
  });
  setInterval(() => {
    const input = field();
    if (!input) return;
    if (wanted > 0) seek(input, wanted);
    wanted = 0;
    parent.postMessage({ at: Number(input.value) }, "*");
  }, 100);
}

function seek(seconds) {
  frame.contentWindow.postMessage({ seek: seconds }, "*");
  frame.scrollIntoView({ block: "nearest" });
}

/* The chart of a side. The SVG is part of the page, with all text escaped. */
function chart(side) {
  const box = make("div", { class: "chart" });
  box.innerHTML = side.gantt;
  const cursor = box.querySelector(".cursor");
  if (cursor) cursors.push([cursor, Number(box.querySelector(".gantt").dataset.until)]);
  box.addEventListener("click", (event) => {
    const span = event.target.closest(".span");
    if (span) seek(Number(span.dataset.start));
  });
  return box;
}

function open(replay) {
  find("h1").textContent = replay.title;
  find(".sentence").textContent = replay.sentence ? `“${replay.sentence}”` : "";
  find(".note").textContent = replay.note;
  steps = [];
  cursors = [];
  document.body.classList.toggle("beside", replay.sides.length > 1);
  delete document.body.dataset.at;
  find(".sides").replaceChildren(...replay.sides.map((side) => {
    const list = make("ol", {}, ...side.steps.map((step) => {
      const button = make("button", { type: "button" }, step.words);
      button.addEventListener("click", () => seek(step.start));
      const item = make("li", {}, button, make("span", { class: step.ok ? "" : "bad" }, step.outcome));
      steps.push([item, step]);
      return item;
    }));
    return make("section", {}, make("h2", {}, side.title), chart(side), list,
      make("div", { class: side.solved ? "verdict solved" : "verdict" }, side.verdict),
      make("div", { class: "reached" }, side.reached));
  }));
  for (const link of document.querySelectorAll(".names a"))
    link.toggleAttribute("aria-current", link.hash.slice(1) === replay.name);
  const recording = document.getElementById("recording-" + replay.name).textContent;
  const darkMode = matchMedia("(prefers-color-scheme: dark)").matches;
  const given = `<script>window.__VISER_EMBED_DATA__ = ${JSON.stringify(recording)};` +
    `window.__VISER_EMBED_CONFIG__ = ${JSON.stringify({ darkMode })};` +
    `(${led})(${Number(replay.opens)});<` + "/script>";
  const at = PLAYER.indexOf("<" + "/head>");
  frame.srcdoc = PLAYER.slice(0, at) + given + PLAYER.slice(at);
}

addEventListener("message", (event) => {
  if (event.source !== frame.contentWindow || typeof event.data?.at !== "number") return;
  const now = event.data.at + 0.05;
  document.body.dataset.at = event.data.at;
  for (const [cursor, until] of cursors) {
    const at = `${Math.min(100, 100 * event.data.at / until).toFixed(2)}%`;
    cursor.setAttribute("x1", at);
    cursor.setAttribute("x2", at);
  }
  for (const [item, step] of steps) {
    item.classList.toggle("later", now < step.start);
    item.classList.toggle("now", step.start <= now && now < step.end);
  }
});
function follow() {
  const name = location.hash.slice(1);
  open(episodes.find((replay) => replay.name === name) || episodes[0]);
}
if (episodes.length > 1)
  find(".names").append(...episodes.map((replay) =>
    make("a", { href: "#" + replay.name }, replay.title)));
addEventListener("hashchange", follow);
follow();
