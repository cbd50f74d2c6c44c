// Shows the newest picture and its scores, and sends the pixel that a person confirms. What labrig says
// enters the page as text, never as HTML.
"use strict";

const PERIOD_MS = 250;
const ENLARGED = 8;
const CROSS_PX = 24;
const SVG = "http://www.w3.org/2000/svg";

const get = (id) => document.getElementById(id);
let shown = { number: -1 };
let isOver = false;
let isLoading = false;

function tell(text, good = false) {
  const status = get("status");
  if (status.textContent !== text) status.textContent = text;
  status.className = good ? "good" : "";
}

function drawLine(group, points, kind) {
  const line = document.createElementNS(SVG, "polyline");
  // Pixel centres are integers; a picture begins half a pixel before the first.
  line.setAttribute("points", points.map(([u, v]) => `${u + 0.5},${v + 0.5}`).join(" "));
  line.setAttribute("class", kind);
  group.append(line);
}

function fillRows(body, rows) {
  body.replaceChildren(...rows.map((cells) => {
    const row = document.createElement("tr");
    cells.forEach(([text, kind, hint], column) => {
      const cell = document.createElement(column ? "td" : "th");
      if (!column) cell.scope = "row";
      cell.textContent = text;
      if (kind) cell.className = kind;
      if (hint) {
        const below = document.createElement("span");
        below.className = "hint";
        below.textContent = hint;
        cell.append(below);
      }
      row.append(cell);
    });
    return row;
  }));
}

function showScores(scores) {
  const grade = (good) => (good === null ? "" : good ? "good" : "bad");
  const word = (good) => (good === null ? "" : good ? "good: " : "bad: ");
  fillRows(get("scores"), scores.map((score) => [
    [score.name], [word(score.good) + score.text, grade(score.good), score.hint], [score.limit],
  ]));
}

function show(state) {
  get("heading").textContent = state.heading;
  document.title = state.heading;
  // A picture that still comes is waited for: a newer one would take its place again and again.
  if (state.number !== shown.number && !isLoading) {
    isLoading = true;
    get("picture").src = `picture?n=${state.number}`;
    get("save").setAttribute("download", `camera-${String(state.number).padStart(6, "0")}.png`);
    get("marks").setAttribute("viewBox", `0 0 ${state.width} ${state.height}`);
  }
  get("judged").hidden = get("tools").hidden = state.asks;
  get("answer").hidden = !state.asks;
  document.body.className = state.asks ? "asks" : "";
  get("u").max = state.width - 1;
  get("v").max = state.height - 1;
  showScores(state.scores);
  shown = state;
}

function drawCross() {
  const [u, v] = [get("u").valueAsNumber, get("v").valueAsNumber];
  const group = get("cross");
  group.replaceChildren();
  const loupe = get("loupe");
  loupe.classList.toggle("empty", Number.isNaN(u) || Number.isNaN(v));
  if (loupe.classList.contains("empty")) return;
  for (const kind of ["outline", "line"]) {
    drawLine(group, [[u - CROSS_PX, v], [u + CROSS_PX, v]], kind);
    drawLine(group, [[u, v - CROSS_PX], [u, v + CROSS_PX]], kind);
  }
  const half = loupe.clientWidth / 2;
  loupe.style.backgroundImage = `url("${get("picture").src}")`;
  loupe.style.backgroundSize = `${ENLARGED * shown.width}px ${ENLARGED * shown.height}px`;
  loupe.style.backgroundPosition = `${half - ENLARGED * (u + 0.5)}px ${half - ENLARGED * (v + 0.5)}px`;
}

function pick(event) {
  if (!shown.asks || isOver) return;
  const box = get("picture").getBoundingClientRect();
  const place = (share, pixels) => Math.min(Math.max(Math.floor(share * pixels), 0), pixels - 1);
  get("u").value = place((event.clientX - box.left) / box.width, shown.width);
  get("v").value = place((event.clientY - box.top) / box.height, shown.height);
  drawCross();
}

function end(text, good) {
  isOver = true;
  tell(text, good);
  for (const id of ["u", "v", "confirm"]) get(id).disabled = true;
}

async function send(event) {
  event.preventDefault();
  get("confirm").disabled = true;
  try {
    const reply = await fetch(`answer?u=${get("u").value}&v=${get("v").value}`);
    const text = await reply.text();
    if (reply.ok || reply.status === 409) end(text, reply.ok);
    else tell(text);
  } catch {
    end("This question is closed: it was answered at the terminal, or the run has ended.");
  }
  get("confirm").disabled = isOver;
}

async function follow() {
  if (isOver) return;
  try {
    const reply = await fetch("state.json");
    if (!reply.ok) throw new Error(reply.statusText);
    const state = await reply.json();
    if (!isOver) {
      if (state.number >= 0) show(state);
      tell("");
    }
  } catch {
    if (!isOver && shown.asks) end("This question is closed: it was answered at the terminal, or the run has ended.");
    else if (!isOver) tell("labrig does not answer: it has ended. This is its last picture.");
  }
  setTimeout(follow, PERIOD_MS);
}

for (const end of ["load", "error"]) get("picture").addEventListener(end, () => { isLoading = false; });
get("picture").addEventListener("click", pick);
get("u").addEventListener("input", drawCross);
get("v").addEventListener("input", drawCross);
get("answer").addEventListener("submit", send);
follow();
