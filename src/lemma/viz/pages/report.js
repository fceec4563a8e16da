"use strict";
const data = JSON.parse(document.getElementById("data").textContent);
const { policies, causes, kinds, cases } = data.failures;
const STEP = 20;
const FAILED = "failed";

/* Creates an element; text is never parsed as HTML. */
function make(tag, attributes, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes || {}))
    if (value !== undefined && value !== false) element.setAttribute(name, value);
  element.append(...children.filter((child) => child !== null && child !== ""));
  return element;
}

/* Copies and downloads. */
async function copy(text) {
  try {
    await navigator.clipboard.writeText(text);
  } catch {
    const area = make("textarea", { "aria-hidden": "true" });
    area.value = text;
    document.body.append(area);
    area.select();
    document.execCommand("copy");
    area.remove();
  }
}
function answer(button, words) {
  const before = button.dataset.words || button.textContent;
  button.dataset.words = before;
  button.textContent = words;
  setTimeout(() => { button.textContent = before; }, 1600);
}
/* As `standalone` in figures.py: plain colors instead of the page's. */
function standalone(svg) {
  return svg.outerHTML.replace(/var\(--[\w-]+, ([^)]+)\)/g, "$1") + "\n";
}
document.addEventListener("click", async (event) => {
  const button = event.target.closest("button");
  if (!button) return;
  if (button.dataset.copy) {
    await copy(data.tables[button.dataset.table][button.dataset.copy]);
    answer(button, "Copied");
  } else if (button.dataset.command) {
    await copy(button.dataset.command);
    answer(button, "Copied");
  } else if (button.dataset.svg) {
    const name = button.dataset.svg;
    const svg = document.getElementById(name).querySelector("svg");
    const file = new Blob([standalone(svg)], { type: "image/svg+xml" });
    const link = make("a", { href: URL.createObjectURL(file), download: name + ".svg" });
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 5000);
  }
});

/* Filters; their state is the hash of the address. */
const words = (text) => text.replaceAll("_", " ");
const unique = (values) => [...new Set(values)].sort();
const FILTERS = {
  policy: { title: "Policy", all: "all", of: (c) => String(c.policy),
    options: policies.map((name, i) => [String(i), name]) },
  kind: { title: "Instructions", all: "all", of: (c) => c.kind, options: Object.entries(kinds) },
  task: { title: "Task", all: "all", of: (c) => c.task,
    options: [...new Set(cases.map((c) => c.task))].map((task) => [task, task]) },
  team: { title: "Team", all: "all", of: (c) => c.team,
    options: unique(cases.map((c) => c.team)).map((team) => [team, team]) },
  cause: { title: "Cause", all: "all", of: (c) => c.cause, options: Object.entries(causes) },
  outcome: { title: "Outcome", all: FAILED, of: (c) => c.outcome,
    options: [["all", "all, solved as well"],
      ...unique(cases.map((c) => c.outcome)).map((name) => [name, words(name)])] },
};
const chosen = { episode: "" };
for (const name of Object.keys(FILTERS)) chosen[name] = "";
let visible = STEP;

function fits(c, without) {
  if (chosen.episode && c.id !== chosen.episode) return false;
  return Object.entries(FILTERS).every(([name, filter]) => {
    const wanted = name === without ? "" : chosen[name];
    if (name === "outcome" && wanted === "") return without === name || c.cause !== "";
    return wanted === "" || wanted === "all" || filter.of(c) === wanted;
  });
}

function readHash() {
  const [part, query] = location.hash.slice(1).split("?");
  const given = new URLSearchParams(query || "");
  for (const name of Object.keys(chosen)) chosen[name] = "";
  chosen.episode = given.get("episode") || "";
  for (const [name, filter] of Object.entries(FILTERS)) {
    const value = given.get(name) || "";
    if (filter.options.some(([key]) => key === value)) chosen[name] = value;
  }
  visible = STEP;
  return part;
}
function writeHash(part) {
  const query = new URLSearchParams(Object.entries(chosen).filter(([, value]) => value));
  const text = query.toString();
  history.replaceState(null, "", "#" + part + (text ? "?" + text : ""));
}

const form = document.querySelector(".filters");
const selects = {};
function build() {
  for (const [name, filter] of Object.entries(FILTERS)) {
    const select = make("select", { name });
    select.addEventListener("change", () => {
      chosen[name] = select.value;
      chosen.episode = "";
      visible = STEP;
      writeHash("failures");
      show();
    });
    selects[name] = select;
    form.append(make("label", {}, filter.title, select));
  }
  const reset = make("button", { type: "button" }, "Reset");
  reset.addEventListener("click", () => {
    for (const name of Object.keys(chosen)) chosen[name] = "";
    visible = STEP;
    writeHash("failures");
    show();
  });
  form.append(reset);
  form.addEventListener("submit", (event) => event.preventDefault());
}
function options() {
  for (const [name, filter] of Object.entries(FILTERS)) {
    const counts = new Map();
    let total = 0;
    for (const c of cases)
      if (fits(c, name)) {
        counts.set(filter.of(c), (counts.get(filter.of(c)) || 0) + 1);
        total += name === "outcome" ? c.cause !== "" : 1;
      }
    const all = [...counts.values()].reduce((a, b) => a + b, 0);
    selects[name].replaceChildren(
      make("option", { value: "" }, `${filter.all} (${total})`),
      ...filter.options.map(([key, title]) => {
        const count = key === "all" ? all : counts.get(key) || 0;
        const option = make("option", { value: key }, `${title} (${count})`);
        option.disabled = count === 0 && chosen[name] !== key;
        return option;
      }));
    selects[name].value = chosen[name];
  }
}

/* Cards. */
function chip(text, kind) { return make("span", { class: "chip " + (kind || "") }, text); }
function picture(source, words, caption, kind) {
  return make("figure", { class: kind },
    make("div", { class: "scroll" }, make("img", { src: source, alt: words, loading: "lazy" })),
    make("figcaption", {}, caption));
}
function media(c) {
  const moment = c.mistake === null ? "at the end" : `before sub-task ${c.mistake + 1}`;
  const posed = c.mistake === null || c.steps[c.mistake].posed;
  const drawn = posed ? "" : " The policy gave no poses, so only the expert's are shown.";
  const box = make("div", { class: "media" },
    picture(c.map, "Map of the table with both choices", `Map from the cameras, ${moment}.${drawn}`, "map"),
    make("div", { class: "pair" },
      picture(c.before, "View of the table " + moment, moment[0].toUpperCase() + moment.slice(1) + "."),
      picture(c.after, "View of the table at the end", "At the end.")));
  if (c.video)
    box.append(make("video", { controls: "", muted: "", playsinline: "", preload: "none",
      src: c.video, poster: c.after, "aria-label": "Video of the episode" }));
  return box;
}
function replay(c) {
  const box = make("div", { class: "replay" });
  function open(source) {
    box.querySelector("iframe")?.remove();
    box.append(make("iframe", { src: source, title: "The episode, to turn around" }));
  }
  const sources = [["the expert", c.replay],
    ...c.beside.map(([number, policy]) => [policy, `${c.replay}?beside=${number}`])];
  for (const [who, source] of sources) {
    const button = make("button", { type: "button" }, `Turn it around, beside ${who}`);
    button.addEventListener("click", () => open(source));
    box.append(button);
  }
  return box;
}
function step(s, mistake) {
  const item = make("li", { class: mistake ? "mistake" : "" }, s.words);
  const facts = [s.outcome === "success" ? "carried out" : s.explanation || words(s.outcome)];
  if (s.duration_s) facts.push(s.duration_s.toFixed(1) + " s");
  if (s.errors) facts.push(s.errors);
  item.append(make("span", {}, facts.join(" · ")));
  if (s.departs)
    // A choice that differs from the expert's may be equally good.
    item.append(make("span", { class: "expert" }, (mistake ? s.departs + "; " : "") + "the expert: " + s.expert));
  return item;
}
function command(title, text) {
  const button = make("button", { type: "button", "data-command": text }, "Copy");
  return make("div", {}, title, make("pre", {}, text), button);
}
function card(c) {
  const box = make("article", { class: "case" + (c.map ? " seen" : ""), tabindex: "-1", "data-id": c.id });
  if (c.map) box.append(media(c));
  const query = new URLSearchParams({ episode: c.id, outcome: "all" });
  box.append(make("header", {},
    make("a", { href: "#failures?" + query }, `${c.task} ${c.index}`),
    ` · ${kinds[c.kind]} · ${c.team} · ${policies[c.policy]}`));
  box.append(make("h3", {}, c.sentence ? `“${c.sentence}”` : "(told nothing)"));
  const chips = make("div", { class: "chips" });
  if (c.cause) chips.append(chip(causes[c.cause], "bad"), chip(words(c.outcome)),
    chip(`${Math.round(100 * c.progress)} % of the stages`),
    ...Object.entries(c.judged).map(([name, found]) =>
      chip(`${name}: ${found}`, { yes: "good", no: "bad" }[found])));
  else chips.append(chip("solved", "good"));
  if (c.elapsed_s) chips.append(chip(c.elapsed_s.toFixed(1) + " simulated s"));
  chips.append(chip(c.distractors + (c.distractors === 1 ? " distractor" : " distractors")));
  box.append(chips);
  if (!c.cause) return box;
  box.append(make("p", { class: "why" }, c.why));
  box.append(make("p", { class: "faint" }, [c.reached, c.trained].join(". ")));
  box.append(make("ol", {}, ...c.steps.map((s, i) => step(s, i === c.mistake))));
  if (!c.steps.length) box.append(make("p", { class: "faint" }, "It did nothing."));
  if (c.gantt) {
    const chart = make("div", { class: "gantt-box" });
    // The SVG is part of the page, with all text escaped.
    chart.innerHTML = c.gantt;
    chart.querySelector(".cursor").remove();
    box.append(chart);
  }
  if (c.differs)
    box.append(make("p", { class: "warning" },
      "The replay here differs from the result, as with other versions or machines. " + c.differs));
  const more = make("details", {}, make("summary", {}, "See it move"));
  if (!c.video) more.append(command("A video of this episode, played again from its line:", c.film));
  if (c.demo)
    more.append(command("The policy again, with this episode alone instead of in a batch of ten. A " +
      "network's last bits may differ, and some decisions with them:", c.demo));
  if (more.children.length > 1) box.append(more);
  if (c.replay) box.append(replay(c));
  return box;
}

const list = document.querySelector(".cards");
const more = document.querySelector(".more");
function show() {
  options();
  const found = cases.filter((c) => fits(c));
  // Sort cases with pictures first; keep the order otherwise.
  found.sort((a, b) => Boolean(b.map) - Boolean(a.map));
  list.replaceChildren(...found.slice(0, visible).map(card));
  const seen = found.filter((c) => c.map).length;
  document.querySelector(".count").textContent = cases.length
    ? `${found.length} of ${cases.length} episodes; ${seen} with pictures.`
    : "These results have no lines of episodes. Use the folders that 'lemma evaluate' or " +
      "'lemma reproduce' wrote.";
  const left = found.length - Math.min(visible, found.length);
  more.hidden = left === 0;
  more.textContent = `Show ${Math.min(STEP, left)} more of ${left}`;
}
more.addEventListener("click", () => {
  const first = visible;
  visible += STEP;
  show();
  list.children[first]?.focus();
});
document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  if (!["j", "k"].includes(event.key) || event.target.closest("select, input, textarea")) return;
  const cards = [...list.children];
  const now = cards.indexOf(document.activeElement.closest(".case"));
  const next = event.key === "j" ? now + 1 : now - 1;
  cards[Math.max(0, Math.min(cards.length - 1, next))]?.focus();
});

/* Links within the page keep the filters. */
function follow() {
  const part = readHash();
  show();
  if (part) document.getElementById(part)?.scrollIntoView({ behavior: "instant" });
}
document.addEventListener("click", (event) => {
  const link = event.target.closest('a[href^="#"]');
  if (!link || link.hash.includes("?")) return;
  event.preventDefault();
  writeHash(link.hash.slice(1));
  document.getElementById(link.hash.slice(1))?.scrollIntoView();
});
addEventListener("hashchange", follow);
build();
if (!cases.length) form.hidden = true;
follow();
