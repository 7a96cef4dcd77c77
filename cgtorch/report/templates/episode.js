"use strict";
const data = JSON.parse(document.getElementById("data").textContent);
const at = (id) => document.getElementById(id);
const linked = data.acts.length > 0;
const last = Math.max(data.frames.length, data.acts.length) - 1;
let timer = 0;
let chosen = 0;

function fill(table, rows) {
  table.querySelectorAll("tr").forEach((row) => row.remove());
  table.hidden = rows.length === 0;
  for (const cells of rows) {
    const row = table.insertRow();
    for (const cell of cells) row.insertCell().textContent = cell;
  }
}

function showStep(number) {
  const step = data.steps[number];
  const name = number === 0 ? "before the first step" : `step ${number - 1} of 0 to ${data.steps.length - 2}: ${step.node}`;
  at("headline").textContent = name;
  fill(at("percept"), step.percept);
  fill(at("about"), step.about);
  for (const item of at("steps").children) item.removeAttribute("aria-current");
  if (number === 0) return;
  const item = at("steps").children[number - 1];
  item.setAttribute("aria-current", "step");
  at("steps").scrollTop = item.offsetTop - at("steps").offsetTop - at("steps").clientHeight / 2;
}

function show(picture) {
  at("slider").value = picture;
  if (data.frames.length) at("picture").src = data.frames[picture];
  if (linked) showStep((chosen = data.acts[picture] + 1));
}

function pause() {
  clearInterval(timer);
  timer = 0;
  at("play").textContent = "Play";
}

function play() {
  if (timer) return pause();
  let now = Number(at("slider").value);
  if (now >= last) now = -1;
  at("play").textContent = "Pause";
  timer = setInterval(() => { show((now += 1)); if (now >= last) pause(); }, data.lasts);
}

function go(step) {
  pause();
  const number = Math.min(Math.max(step, 0), data.steps.length - 1);
  if (!linked) return showStep((chosen = number));
  let picture = data.acts.findIndex((act) => act + 1 >= number);
  if (picture < 0) picture = last;
  show(picture);
  showStep((chosen = number));
}

data.steps.slice(1).forEach((step, i) => {
  const item = document.createElement("li");
  item.textContent = step.node;
  item.addEventListener("click", () => go(i + 1));
  at("steps").append(item);
});
at("slider").max = last;
at("slider").addEventListener("input", () => { pause(); show(Number(at("slider").value)); });
at("play").addEventListener("click", play);
at("back").addEventListener("click", () => go(chosen - 1));
at("next").addEventListener("click", () => go(chosen + 1));
show(0);
showStep(0);
