// What is shown now, how it changes with time, pointer and keys, the index, and the link that holds it.
const now = { scene: null, time: 0, playing: false, agent: null, cell: null, beside: "", hash: "", step: -1, ms: 0, frames: 0 };
let panes = [], pending = 0, drawnAt = 0;
const stepOf = () => Math.min(now.scene.last, Math.max(0, Math.round(now.time / now.scene.step_s)));

function draw() {
  const { scene } = now, step = stepOf(), cells = $("cells").checked;
  const at = now.agent && $("follow").checked ? pose(scene.byId.get(now.agent), now.time, scene) : null;
  if (at) Object.assign(view, { x: at.x, y: at.y });
  for (const pane of panes) {
    pane.drawGround({ cells, cell: pane.scene === scene ? now.cell : null });
    pane.drawFront({ time: now.time, agent: now.agent, trails: $("trails").checked, names: $("names").checked });
  }
  if (step !== now.step) atStep(step);
}
function atStep(step) {
  const { scene } = now;
  now.step = step, $("slider").value = step;
  $("clock").textContent = `${fixed(step * scene.step_s)} s, ${step < scene.observed ? "observed" : "future"}`;
  for (const cursor of $("panel").querySelectorAll(".cursor")) for (const end of ["x1", "x2"]) cursor.setAttribute(end, chartX(scene, step));
  for (const row of $("panel").querySelectorAll("tr[data-step]")) row.classList.toggle("now", step >= row.dataset.step && step < row.dataset.until);
  if ($("live") && !$("live").matches(":active")) $("live").innerHTML = escaped(now.agent ? agentNow(scene, now.agent, step) : cellNow(scene, now.cell, step));
}
function redraw() { pending ||= requestAnimationFrame(frame); }
function frame(stamp) {
  const passed = Math.min(0.25, (stamp - drawnAt) / 1000);
  pending = 0, drawnAt = stamp;
  if (!now.scene) return;
  const began = performance.now(), end = now.scene.last * now.scene.step_s;
  if (now.playing) now.time = Math.min(end, now.time + passed * Number($("rate").value));
  if (now.playing && now.time >= end) play(false);
  draw(), now.ms = performance.now() - began, now.frames += 1;
  if (now.playing) redraw();
}
function play(on) {
  if (on && stepOf() === now.scene.last) now.time = 0;
  now.playing = on, drawnAt = performance.now();
  $("play").textContent = on ? "❚❚" : "▶", $("play").setAttribute("aria-label", on ? "pause" : "play");
  if (!on) goTo(stepOf());
  redraw();
}
function goTo(step) {
  now.time = Math.min(now.scene.last, Math.max(0, step)) * now.scene.step_s;
  remember(), redraw();
}
function choose(agent, cell = null) {
  const { scene } = now;
  Object.assign(now, { agent, cell, step: -1 });
  if (!agent) $("follow").checked = false;
  $("panel").innerHTML = escaped(agent ? agentPanel(scene, agent) : cell !== null ? cellPanel(scene, cell) : scenePanel(scene));
  $("panel").scrollTop = 0, remember(), redraw();
}

async function show(number, { time = 0, agent = null, beside = "" } = {}) {
  const scene = await open(number), { facts } = scene;
  Object.assign(now, { scene, time: Math.max(0, Math.min(time, scene.last * scene.step_s)), playing: false, agent: null, cell: null, step: -1 });
  $("panel").replaceChildren(), $("index").hidden = true, $("scene").hidden = $("tools").hidden = false, $("many").hidden = FACTS.length < 2;
  $("play").textContent = "▶", $("slider").max = scene.last;
  $("title").textContent = document.title = `${scene.city} ${short(scene.id)}: ${facts.recorded} ${scene.word}, ${facts.inserted} inserted`;
  const same = FACTS.filter((one) => one.id !== scene.id && one.source === facts.source);
  $("beside").innerHTML = escaped(html`<option value="">nothing</option>
${facts.inserted && scene.word === "recorded" ? html`<option value="before">as recorded</option>` : ""}
${same.map((one) => html`<option value="${one.id}">${short(one.id)}, ${one.inserted} inserted</option>`)}`);
  $("beside").parentNode.hidden = $("beside").options.length < 2;
  $("beside").value = beside, now.beside = $("beside").value ||= "";
  $("marks").innerHTML = escaped(scene.marks.map((one) => html`<button tabindex="-1" data-agent="${one.agent}" data-step="${one.step}"
title="${fixed(one.step * scene.step_s)} s: ${one.says}" style="left:${(100 * one.step) / scene.last}%;top:${one.line * 16}px;color:${one.color}">${one.sign}</button>`));
  view.fitted = looksAt(), await split(), choose(scene.byId.has(agent) ? agent : null);
}
async function split() { // one pane, or two of the same place
  const { scene, beside } = now, number = FACTS.findIndex((one) => one.id === beside);
  const title = (one) => `${short(one.id)}, ${one.facts.inserted} inserted`;
  panes = [new Pane(scene, beside === "before" ? "after" : beside ? title(scene) : "")];
  if (beside === "before") panes.unshift(new Pane(scene, "before, as recorded", { without: true }));
  if (number >= 0) panes.push(new Pane(await open(number), title(await open(number))));
  $("panes").replaceChildren(...panes.map((pane) => pane.node)), $("panes").classList.toggle("two", panes.length > 1);
  panes.forEach(listen), resize();
  const kinds = new Set(panes.flatMap((pane) => pane.scene.tracks.map((track) => track.kind)));
  $("legend").innerHTML = escaped(html`${Object.entries(scene.kinds).filter(([kind]) => kinds.has(kind)).map(([kind, says]) =>
    html`<span>${chip(kind)}${says}</span>`)}<span><i class="chip focal"></i>focal track</span>
${scene.marks.length ? html`<span>◆ manoeuvre ✕ aborted ★ event ▲ finding</span>` : ""}`);
}
function resize() {
  for (const pane of panes) pane.setSize(pane.node.clientWidth, pane.node.clientHeight, window.devicePixelRatio || 1);
  if (panes.length && view.fitted === looksAt()) fit(panes); // the view was not moved
  redraw();
}

const FILTERS = { city: (one) => [one.city], behaviour: (one) => Object.keys(one.behaviours), reason: (one) => one.reasons,
  event: (one) => one.events.map(([kind, status]) => `${kind} ${status}`) };
function showIndex() {
  Object.assign(now, { scene: null, playing: false, hash: "" }), panes = [];
  $("index").hidden = false, $("scene").hidden = $("tools").hidden = $("many").hidden = true;
  $("title").textContent = document.title = count(FACTS.length, "scene");
  address("");
  if ($("cards").children.length) return;
  $("filters").innerHTML = escaped(html`${Object.entries(FILTERS).map(([name, of]) => {
    const values = FACTS.flatMap((one) => [...new Set(of(one))]), number = (value) => values.filter((one) => one === value).length;
    return html`<label>${name}<select id="of-${name}"><option value="">any</option>${[...new Set(values)].sort().map((value) =>
      html`<option value="${value}">${words(value)} (${number(value)})</option>`)}</select></label>`;
  })}<output id="number"></output>`);
  $("cards").innerHTML = escaped(FACTS.map(CARD));
  const watch = new IntersectionObserver((entries) => entries.filter((entry) => entry.isIntersecting).forEach(async ({ target }) => {
    watch.unobserve(target), thumbnail(target.firstElementChild, await unpack(Number(target.dataset.scene)));
  }));
  [...$("cards").children].forEach((card) => watch.observe(card)), filter();
}
function filter() {
  const fits = (one) => Object.entries(FILTERS).every(([name, of]) => !$(`of-${name}`).value || of(one).includes($(`of-${name}`).value));
  FACTS.forEach((one, k) => { $("cards").children[k].hidden = !fits(one); });
  $("number").textContent = `${FACTS.filter(fits).length} of ${FACTS.length}`;
}

function remember() { // scene, agent and time stand in the address, as they are when nothing plays
  if (now.playing) return;
  const parts = { scene: now.scene.id, t: fixed(stepOf() * now.scene.step_s, 2), agent: now.agent, beside: now.beside };
  now.hash = `#${new URLSearchParams(Object.entries(parts).filter(([, value]) => value))}`;
  address(now.hash);
}
function address(hash) {
  try { history.replaceState(null, "", hash || location.pathname); } catch { now.hash = ""; } // a frame without an address
}
function followLink() {
  const parts = Object.fromEntries(new URLSearchParams(location.hash.slice(1))), number = FACTS.findIndex((one) => one.id === parts.scene);
  if (location.hash && location.hash === now.hash) return undefined;
  return number < 0 && FACTS.length > 1 ? showIndex() : show(Math.max(0, number), { ...parts, time: Number(parts.t) || 0 });
}

function zoom(factor, pane = panes[0], px = pane.wide / 2, py = pane.high / 2) {
  const [x, y] = pane.place(px, py);
  view.scale = Math.min(MAX_SCALE, Math.max(MIN_SCALE, view.scale * factor));
  const [east, north] = pane.place(px, py);
  Object.assign(view, { x: view.x + x - east, y: view.y + y - north }), redraw();
}
function pan(px, py) { Object.assign(view, { x: view.x + px / view.scale, y: view.y + py / view.scale }), $("follow").checked = false, redraw(); }
function listen(pane) {
  const { front } = pane, held = new Map();
  let moved = 0;
  front.onpointerdown = (event) => {
    front.setPointerCapture(event.pointerId), moved = held.size ? Infinity : 0, held.set(event.pointerId, [event.offsetX, event.offsetY]);
  };
  front.onpointermove = ({ pointerId, offsetX: px, offsetY: py }) => {
    const [x, y] = pane.place(px, py), { origin, city } = pane.scene, was = held.get(pointerId);
    $("cursor").textContent = `${city} ${fixed(x + origin[0])}, ${fixed(y + origin[1])} m`;
    if (!was) return;
    const [, other] = [...held].find(([id]) => id !== pointerId) ?? [], apart = (one) => Math.hypot(one[0] - other[0], one[1] - other[1]);
    if (other) zoom(apart([px, py]) / (apart(was) || 1), pane, ...other);
    moved += Math.hypot(px - was[0], py - was[1]);
    if (moved <= 4) return;
    held.set(pointerId, [px, py]);
    if (!other) pan(was[0] - px, py - was[1]);
  };
  front.onpointerup = ({ pointerId, offsetX, offsetY }) => {
    held.delete(pointerId);
    if (moved > 4) return;
    const { track, cell } = pane.hit(offsetX, offsetY, now.time), agent = track?.id ?? null;
    if (pane.scene === now.scene) choose(agent, !track && $("cells").checked && cell >= 0 ? cell : null);
    else if (track) show(pane.scene.number, { time: now.time, agent, beside: now.scene.id });
  };
  front.onpointercancel = ({ pointerId }) => held.delete(pointerId);
  front.onwheel = (event) => { event.preventDefault(), zoom(Math.exp(-event.deltaY / 500), pane, event.offsetX, event.offsetY); };
}
function nextAgent(by) {
  const names = now.scene.order.filter((track) => rank(track) > 1).map((track) => track.id).sort(new Intl.Collator("en", { numeric: true }).compare);
  choose(names.at((names.indexOf(now.agent) + (now.agent || by > 0 ? by : 0)) % names.length));
}
function nextMark(by) {
  const step = stepOf(), mark = by > 0 ? now.scene.marks.find((one) => one.step > step) : now.scene.marks.findLast((one) => one.step < step);
  if (mark) choose(mark.agent), goTo(mark.step);
}
function follow() { // an agent, from near enough
  if ($("follow").checked && !now.agent) nextAgent(1);
  if ($("follow").checked) view.scale = Math.max(view.scale, 5);
  redraw();
}
const turn = (id) => () => $(id).click();
const KEYS = {
  " ": ["play, pause", () => play(!now.playing)], ArrowRight: ["a step on", () => goTo(stepOf() + 1)], ArrowLeft: ["a step back", () => goTo(stepOf() - 1)],
  Home: ["first step", () => goTo(0)], End: ["last step", () => goTo(now.scene.last)], m: ["next mark", () => nextMark(1)], M: ["mark before", () => nextMark(-1)],
  n: ["next agent: inserted, focal, AV", () => nextAgent(1)], N: ["agent before", () => nextAgent(-1)], Escape: ["choose none", () => choose(null)],
  "+": ["nearer", () => zoom(1.25)], "-": ["farther", () => zoom(0.8)], 0: ["all traffic", turn("fit")], w: ["up", () => pan(0, 60)], a: ["left", () => pan(-60, 0)],
  s: ["down", () => pan(0, -60)], d: ["right", () => pan(60, 0)], f: ["follow the agent", turn("follow")], t: ["trails", turn("trails")],
  c: ["cells of 4 m", turn("cells")], l: ["names", turn("names")], b: ["before and after", () => beside(now.beside ? "" : "before")],
  "?": ["these keys", () => $("help").showModal()],
};
function beside(id) {
  $("beside").value = id, now.beside = $("beside").value ||= "";
  remember(), split();
}
document.onkeydown = (event) => {
  const known = KEYS[event.key], own = event.target.matches("select") || (event.key === " " && event.target.matches("button,input,summary"));
  if (known && now.scene && !own && !event.ctrlKey && !event.metaKey && !event.altKey && !$("help").open) event.preventDefault(), known[1]();
};
document.onclick = ({ target, clientX }) => {
  const { agent, step, scene } = target.closest?.("[data-agent],[data-step],[data-scene]")?.dataset ?? {}, drawn = target.closest?.("svg.chart");
  if (scene) show(Number(scene));
  if (agent) choose(agent);
  if (step) goTo(Number(step));
  if (drawn) goTo(Math.round((((330 * (clientX - drawn.getBoundingClientRect().left)) / drawn.clientWidth - 30) / 294) * now.scene.last));
};
$("keylist").innerHTML = escaped(Object.entries(KEYS).map(([key, [says]]) => html`<dt>${key === " " ? "space" : key}</dt><dd>${says}</dd>`));
$("play").onclick = KEYS[" "][1], $("home").onclick = showIndex, $("keys").onclick = KEYS["?"][1];
$("fit").onclick = () => { fit(panes), redraw(); };
$("slider").oninput = () => { const step = Number($("slider").value); play(false), goTo(step); };
$("beside").onchange = () => beside($("beside").value);
$("filters").onchange = filter, $("follow").onchange = follow;
for (const id of ["trails", "cells", "names"]) $(id).onchange = redraw;
for (const [id, by] of [["previous", -1], ["next", 1]]) $(id).onclick = () => show((now.scene.number + by + FACTS.length) % FACTS.length);
$("link").onclick = () => { remember(), navigator.clipboard?.writeText(location.href), $("link").textContent = "Copied", setTimeout(() => { $("link").textContent = "Link"; }, 1500); };
window.onresize = resize, window.onhashchange = followLink;
followLink();
