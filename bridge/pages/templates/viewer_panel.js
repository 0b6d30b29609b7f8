// The panel: the story of one agent, the occupancy of one cell, or what was asked of the scene and done.
class Markup { constructor(text) { this.text = text; } }
const escaped = (value) => (value instanceof Markup ? value.text : Array.isArray(value) ? value.map(escaped).join("")
  : String(value ?? "").replace(/[&<>"']/g, (letter) => `&#${letter.charCodeAt(0)};`));
const html = (parts, ...values) => new Markup(parts.reduce((text, part, k) => text + escaped(values[k - 1]) + part));
const count = (number, what) => `${number} ${what}${number === 1 ? "" : "s"}`;
const why = (reason) => SHARED.reasons[String(reason).split(":")[0]] ?? "";
const reasonOf = (text) => html`<span title="${why(text)}">${words(text)}</span>`;
const chip = (kind) => html`<i class="chip" style="background:${SHARED.faces[kind] ?? SHARED.faces.generated}"></i>`;
const linked = (scene, id) => (scene.byId.has(id) ? html`<button class="to" data-agent="${id}">${id}</button>` : id ?? "–");
const table = (head, rows) => html`<table><tr>${head.map((one) => html`<th>${one}</th>`)}</tr>
${rows.map((row) => (row instanceof Markup ? row : html`<tr>${row.map((one) => html`<td class="${typeof one === "number" ? "n" : ""}">${one ?? "–"}</td>`)}</tr>`))}</table>`;
const section = (title, body) => html`<h3>${title}</h3>${body}`;
const MOMENTS = { trigger: "2 3", start: "6 3", crossing: "", end: "8 3 2 3" };
const EVENT = [["gap_m", "gap", "m"], ["min_ttc_s", "least TTC", "s"], ["pet_s", "PET", "s"], ["drac_mps2", "DRAC", "m/s²"], ["brakes_mps2", "brakes with", "m/s²"]];

function scenePanel(scene) {
  const { said, facts } = scene;
  const head = html`<h2>${scene.city}: ${facts.recorded} ${scene.word}, ${facts.inserted} inserted</h2><p>${scene.id}</p>
<p class="muted">Choose a vehicle for its story or, with cells shown, a cell for its occupancy.</p>`;
  if (!said.requested) return head;
  const { agents, behaviours } = said.requested, asked = [...said.agents, { maneuvers: said.unmet }], maneuvers = asked.flatMap((agent) => agent.maneuvers.map((one) =>
    [linked(scene, agent.track_id), words(one.kind), words(one.status), one.reason ? reasonOf(one.reason) : ""]));
  const events = said.events.map((one) => [words(one.kind), linked(scene, one.target_track_id ?? one.target), linked(scene, one.track_id),
    one.at_s === null ? "–" : `${fixed(one.at_s)} s`, one.status === "done" ? "done" : reasonOf(one.reason ?? one.status)]);
  return [head, section("Asked for and placed", html`<p>${agents} asked for, ${said.placed.agents} placed; seed ${said.seed}, variant ${said.variant}</p>
${table(["behaviour", "share asked", "placed"], Object.entries(behaviours).map(([kind, share]) =>
    [html`${chip(kind)}${SHARED.label[kind] ?? words(kind)}`, fixed(share, 3), said.placed.behaviours[kind] ?? 0]))}`),
  events.length ? section("Events", table(["event", "with", "by", "at", "what came of it"], events)) : "",
  scene.findings.length ? section("What the judge finds", findings(scene, scene.findings)) : "",
  maneuvers.length ? section("Manoeuvres", table(["vehicle", "manoeuvre", "status", "reason"], maneuvers)) : "",
  said.rejected.length ? section("Turned down", table(["reason", "vehicles and sites"], said.rejected.map((one) => [reasonOf(one.reason), one.count]))) : ""];
}

const findings = (scene, found) => found.map((one) => html`<p class="bad">${linked(scene, one[0])}
${findingText(one).slice(one[0].length)}, <button class="to" data-step="${one[1]}">${fixed(one[1] * scene.step_s)} s</button></p>`);

function cellPanel(scene, number) {
  const cell = scene.cells[number], rows = occupancyOf(scene, number).map(([track, first, after]) =>
    html`<tr data-step="${first}" data-until="${after}"><td>${linked(scene, track.id)}</td><td>${track.inserted ? 2 : 1}</td>
<td>${fixed(first * scene.step_s)} to ${fixed((after - 1) * scene.step_s)} s</td></tr>`);
  return html`<h2>Cell ${cell.index} of lane ${cell.lane}</h2><div id="live"></div>
${rows.length ? table(["agent", "σ", "its box covers the cell"], rows) : html`<p>Free in the whole scene.</p>`}
<p class="muted">σ: 0 free, 1 original, 2 generated; boxes as exported.</p>`;
}
function cellNow(scene, number, step) {
  const here = occupancyOf(scene, number).filter(([, first, after]) => step >= first && step < after).map(([track]) => track);
  const sigma = here.some((track) => !track.inserted) ? "1, original" : here.length ? "2, generated" : "0, free";
  return html`<p>Now σ = ${sigma} ${here.map((track) => linked(scene, track.id))}</p>`;
}

function agentPanel(scene, id) {
  const track = scene.byId.get(id), record = scene.record.get(id), { events = [] } = scene.said;
  const own = events.filter((one) => one.status === "done" && [one.track_id, one.target_track_id].includes(id));
  return html`<h2>${chip(track.kind)}${id}</h2><p>${scene.kinds[track.kind]}${record && !(record.policy in SHARED.label) ? ` (${words(record.policy)})` : ""}${track.focal ? ", focal track" : ""};
${words(track.type)}, ${track.size[0]} × ${track.size[1]} m</p>
${(record?.maneuvers ?? []).map(maneuver)}${own.map((one) => html`<p><b>event ${words(one.kind)}</b> of ${linked(scene, one.track_id)} with
${linked(scene, one.target_track_id)} at ${fixed(one.at_s)} s${EVENT.filter(([key]) => one[key] !== null).map(([key, name, unit]) => `, ${name} ${fixed(one[key])} ${unit}`)}</p>`)}
${findings(scene, scene.findings.filter((one) => one[0] === id || one[5] === id))}
<div id="live"></div>${charts(scene, track, record)}${record ? [limits(record), looks(scene, id, record)] : ""}`;
}
function maneuver(one) {
  const times = Object.keys(MOMENTS).filter((name) => one[`${name}_s`] !== null).map((name) => `${name} ${fixed(one[`${name}_s`])} s`);
  const gap = (value) => (value === null ? "none" : `${fixed(value)} m`), told = [times.join(", ")];
  if (one.reason) told.unshift(`${words(one.reason)}: ${why(one.reason)}`);
  if (one.target_lane !== null) told.push(`lane ${one.source_lane} to ${one.target_lane}`);
  if (one.target_lane !== null && one.requested_s !== null) told.push(`gap ahead ${gap(one.gap_front_m)}, behind ${gap(one.gap_rear_m)}`);
  if (one.min_ttc_s !== null) told.push(`least TTC ${fixed(one.min_ttc_s)} s`);
  return html`<p><b>${words(one.kind)}</b> <span class="${one.status === "done" ? "good" : "bad"}">${words(one.status)}</span>; ${told.join("; ")}</p>`;
}
function agentNow(scene, id, step) {
  const at = stateOf(scene, id, step), side = at?.offset < 0 ? "right" : "left";
  if (!at) return html`<p class="muted">Not in the scene at this time.</p>`;
  const gap = (name, other, value) => html`<p>Gap ${name}: ${other ? html`${fixed(value)} m to ${linked(scene, other)}` : "no vehicle within 100 m"}</p>`;
  return html`<p>${fixed(at.speed)} m/s, ${fixed(at.accel, 2)} m/s²${Number.isFinite(at.offset) ? `, ${fixed(Math.abs(at.offset), 2)} m ${side} of its first lane` : ""}</p>
<p class="muted">lane ${at.lane ?? "–"}, city x ${fixed(at.x, 2)}, y ${fixed(at.y, 2)} m</p>
${scene.byId.get(id).leader ? [gap("ahead", at.leader, at.gap), gap("behind", at.follower, at.lag)] : ""}`;
}

function charts(scene, track, record) {
  const moments = (record?.maneuvers ?? []).flatMap((one) => Object.keys(MOMENTS).map((name) => [name, one[`${name}_s`]])).filter(([, s]) => s !== null);
  const seen = scene.looks[track.id] ?? [], { blue, green, orange } = SHARED.series;
  const all = [["speed, m/s", track.speed, blue, 0], ["acceleration, m/s²", track.accel, blue], ["lateral offset, m (left is positive)", track.offset, green],
    ["gap ahead, m", track.gap, orange, 0], ["gap behind, m", track.lag, orange, 0]];
  return html`${all.filter(([, values]) => values).map(([name, values, color, least]) => section(name, chart(scene, track, values, { color, least, moments, seen })))}
<p class="muted">${moments.length ? "Lines: trigger dotted, start dashed, crossing solid, end dash-dotted. " : ""}${seen.length ? "Ticks below: looks at gaps, black where taken." : ""}</p>`;
}
const chartX = (scene, step) => 30 + (step / scene.last) * 294; // of 330
function chart(scene, track, values, { color, least, moments, seen }) {
  const known = values.filter(Number.isFinite), at = (s) => fixed(chartX(scene, s / scene.step_s));
  if (!known.length) return html`<p class="muted">none</p>`;
  let [low, top] = [Math.min(least ?? Infinity, ...known), Math.max(...known)];
  if (top - low < 1) [low, top] = [low - (least === undefined ? 0.5 : 0), top + 0.5];
  const y = (value) => fixed(66 - ((value - low) / (top - low)) * 58), across = (value, paint) => html`<line x1="30" x2="324" y1="${y(value)}" y2="${y(value)}" stroke="${paint}"/>`;
  let path = "", pen = "M";
  track.row.forEach((row, step) => {
    const value = row < 0 ? NaN : values[row];
    if (Number.isFinite(value)) path += `${pen}${fixed(chartX(scene, step))} ${y(value)}`;
    pen = Number.isFinite(value) ? "L" : "M";
  });
  return html`<svg class="chart" viewBox="0 0 330 74" preserveAspectRatio="none">
${[low, top].map((value) => html`<text x="2" y="${Number(y(value)) + 4}">${fixed(value)}</text>${across(value, "#ddd")}`)}${low < 0 && top > 0 ? across(0, "#999") : ""}
${moments.map(([name, s]) => html`<line x1="${at(s)}" x2="${at(s)}" y1="4" y2="68" stroke="#4D4D4D" stroke-dasharray="${MOMENTS[name]}"><title>${name}</title></line>`)}
<path d="${path}" fill="none" stroke="${color}" stroke-width="1.8"/>
${seen.map((look) => html`<line x1="${at(look.time_s)}" x2="${at(look.time_s)}" y1="69" y2="74" stroke="${answerOf(look) === "taken" ? "#000" : SHARED.faces.generated}"/>`)}
<line class="cursor" y1="0" y2="74" stroke="${SHARED.highlight}" stroke-width="1.5"/></svg>`;
}

function limits(record) {
  const rows = Object.entries(record.limited).filter(([, share]) => share > 0).sort((a, b) => b[1] - a[1]);
  const share = rows.map(([cause, part]) => [words(cause), `${fixed(100 * part)} %`]);
  return section("Held below SUMO's own speed", rows.length ? table(["for", "share of its steps"], share) : html`<p>never</p>`);
}
function looks(scene, id, record) {
  const { looked_at: all, refused_by_rule: rule, refused_by_sumo: sumo } = record.gaps, seen = scene.looks[id] ?? [];
  const gap = (value, other) => html`<td class="n" title="${other}">${fixed(value)}</td>`;
  const rows = seen.map((look) => {
    const step = Math.round(look.time_s / scene.step_s), answer = answerOf(look);
    return html`<tr data-step="${step}" data-until="${step + 1}"><td class="n">${fixed(look.time_s)}</td>
<td title="lane ${look.lane_id}, cell ${look.cell}">${look.side}</td>${gap(look.lead_gap_m, look.lead_id)}${gap(look.lag_gap_m, look.lag_id)}
<td title="${answer.split(", ").map(why).join(" ")}" class="${answer === "taken" ? "good" : ""}">${words(answer)}</td></tr>`;
  });
  return section("Looks at gaps", html`<p>${count(all, "look")}; ${rule} refused by rule or guard, ${sumo} by SUMO</p>
${rows.length ? html`<div class="looks">${table(["s", "side", "lead, m", "lag, m", "answer"], rows)}</div>
<p class="muted">As simulated, to vehicles that were not exported as well; gaps above are of what was exported.</p>`
    : all ? html`<p class="muted">hid2 generate --record gaps writes down each of them.</p>` : ""}`);
}

const CARD = (one, k) => {
  const done = (rows) => `${rows.filter(([, status]) => status === "done").length} of ${rows.length} done`;
  const kinds = [...new Set(one.events.map(([kind]) => words(kind)))].join(", ");
  return html`<button class="card" data-scene="${k}"><canvas width="460" height="300"></canvas><strong>${one.city} ${short(one.id)}${one.split ? html` · ${one.split}` : ""}</strong>
<span>${one.recorded} ${one.word}${one.asked === null ? "" : `, ${one.inserted} of ${one.asked} inserted`}, ${fixed(one.seconds)}\u00a0s</span>
<span>${Object.entries(one.behaviours).map(([kind, number]) => html`<label>${chip(kind)}${number} ${SHARED.label[kind] ?? words(kind)}</label> `)}</span>
${one.events.length ? html`<span>events (${kinds}): ${done(one.events)}</span>` : ""}
${one.maneuvers.length ? html`<span>manoeuvres: ${done(one.maneuvers)}</span>` : ""}${one.findings ? html`<span class="bad">${count(one.findings, "finding")}</span>` : ""}</button>`;
};
