"use strict";
// What a scene is: unpacked (the inverse of bridge/pages/viewer.py), and asked for states, occupancy and marks.
// Coordinates are metres east and north of the scene's origin.
const $ = (id) => document.getElementById(id);
const SHARED = JSON.parse($("shared").textContent), FACTS = JSON.parse($("facts").textContent);
const PACKED = [...document.getElementsByClassName("packed")], OPENED = new Map();
const words = (text) => String(text).replaceAll("_", " ");
const fixed = (value, digits = 1) => (Number.isFinite(value) ? value.toFixed(digits) : "–");
const short = (id) => (id.length === 36 ? id.slice(0, 8) : id); // of a UUID

function summed(values, order = 1) {
  const out = Int32Array.from(values);
  for (; order > 0; order -= 1) for (let k = 1; k < out.length; k += 1) out[k] += out[k - 1];
  return out;
}
const numbers = (values, quantum, order) =>
  Float64Array.from(summed(values, order), (value) => (value === SHARED.none ? NaN : value * quantum));

function line([x, y]) {
  const [east, north] = [numbers(x, SHARED.metre), numbers(y, SHARED.metre)];
  return Array.from(east, (value, k) => [value, north[k]]);
}

function unpackTrack(raw, steps) { // row: of each step, -1 where the track is absent
  const track = { ...raw, row: new Int32Array(steps).fill(-1), heading: numbers(raw.heading, SHARED.radian, 2) };
  let rows = 0;
  for (const [first, length] of raw.runs) for (let k = 0; k < length; k += 1) track.row[first + k] = rows++;
  for (const name of ["x", "y"]) track[name] = numbers(raw[name], SHARED.metre, 2);
  for (const name of ["speed", "accel", "offset", "gap"]) if (raw[name]) track[name] = numbers(raw[name], SHARED.metre);
  if (!raw.leader) return track;
  track.leader = summed(raw.leader), track.follower = new Int32Array(rows).fill(-1), track.lag = new Float64Array(rows).fill(NaN);
  return Object.assign(track, { lane: summed(raw.lane) });
}

function cut(points, parts) { // the ends of pieces of equal length of a polyline
  const along = [0], ends = [];
  for (let k = 1; k < points.length; k += 1)
    along.push(along[k - 1] + Math.hypot(points[k][0] - points[k - 1][0], points[k][1] - points[k - 1][1]));
  for (let part = 0, k = 0; part <= parts; part += 1) {
    const s = (along.at(-1) * part) / parts;
    while (k < along.length - 2 && along[k + 1] < s) k += 1;
    const share = (s - along[k]) / (along[k + 1] - along[k] || 1);
    ends.push([0, 1].map((axis) => points[k][axis] + share * (points[k + 1][axis] - points[k][axis])));
  }
  return ends;
}

function trace(path, points, closed) {
  points.forEach(([x, y], k) => (k ? path.lineTo(x, y) : path.moveTo(x, y)));
  if (closed) path.closePath();
}

function unpackMap({ ground, crossings, lanes }) {
  const paths = Object.fromEntries(["ground", "crossing", "bike", "edge", "centre", "cell"].map((name) => [name, new Path2D()]));
  const cells = [];
  for (const ring of ground) trace(paths.ground, line(ring), true);
  for (const ring of crossings) trace(paths.crossing, line(ring), true);
  for (const [lane, type, parts, ...sides] of lanes) {
    const [left, right, centre] = sides.map(line), [a, b] = [cut(left, parts), cut(right, parts)];
    if (type === "BIKE") trace(paths.bike, [...left, ...right.reverse()], true);
    else trace(paths.centre, centre);
    trace(paths.edge, left), trace(paths.edge, right);
    for (let k = 0; k < parts; k += 1) {
      cells.push({ lane, index: k, ring: [a[k], a[k + 1], b[k + 1], b[k]] });
      trace(paths.cell, cells.at(-1).ring, true);
    }
  }
  return { paths, cells };
}

async function unpack(number) {
  const bytes = Uint8Array.from(atob(PACKED[number].textContent), (letter) => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  const scene = await new Response(stream).json();
  Object.assign(scene, unpackMap(scene.map), { number, facts: FACTS[number], last: scene.steps - 1 });
  scene.tracks = scene.tracks.map((raw) => unpackTrack(raw, scene.steps));
  scene.tracks.forEach((track, agent) => track.leader && track.row.forEach((row, step) => {
    const ahead = row < 0 ? null : scene.tracks[track.leader[row]], there = ahead?.row[step];
    if (ahead?.follower && !(ahead.lag[there] <= track.gap[row])) ahead.follower[there] = agent, ahead.lag[there] = track.gap[row];
  }));
  scene.byId = new Map(scene.tracks.map((track) => [track.id, track]));
  scene.order = [...scene.tracks].sort((a, b) => rank(a) - rank(b));
  scene.record = new Map((scene.said.agents ?? []).map((agent) => [agent.track_id, agent]));
  scene.occupied = scene.occupied.map((column) => summed(column));
  for (const [id, looks] of Object.entries(scene.looks))
    scene.looks[id] = looks.map((look) => Object.fromEntries(SHARED.look_columns.map((name, k) => [name, look[k]])));
  return Object.assign(scene, { marks: marksOf(scene) });
}

function open(number) { // at most 40 stay open: of hundreds the memory would fill
  if (OPENED.size > 40) OPENED.clear();
  if (!OPENED.has(number)) OPENED.set(number, unpack(number));
  return OPENED.get(number);
}

const rank = (track) => (track.inserted ? 3 : track.kind === "av" || track.focal ? 2 : track.kind === "other" ? 0 : 1);

function pose(track, time, scene) { // between two states while it moves on; null where it is absent
  const at = Math.min(scene.last, time / scene.step_s + 1e-9), step = Math.floor(at), row = track.row[step];
  if (row < 0) return null;
  const share = at - step > 0.01 && track.row[step + 1] === row + 1 ? at - step : 0, next = row + (share ? 1 : 0);
  const between = (values) => values[row] + share * (values[next] - values[row]);
  return { row, x: between(track.x), y: between(track.y), heading: between(track.heading) };
}

function stateOf(scene, id, step) { // of an agent at a step, in city coordinates; null where it is absent
  const track = scene.byId.get(id), row = track.row[step], [east, north] = scene.origin;
  if (row < 0) return null;
  return {
    x: track.x[row] + east, y: track.y[row] + north, heading: track.heading[row], speed: track.speed[row],
    accel: track.accel?.[row], offset: track.offset?.[row], lane: scene.map.lanes[track.lane?.[row]]?.[0], gap: track.gap?.[row], lag: track.lag?.[row],
    leader: scene.tracks[track.leader?.[row]]?.id, follower: scene.tracks[track.follower?.[row]]?.id,
  };
}

function occupancyOf(scene, cell) { // which boxes cover a cell: [track, first step, step after the last]
  const [of, agent, first, length] = scene.occupied, found = [];
  of.forEach((one, k) => one === cell && found.push([scene.tracks[agent[k]], first[k], first[k] + length[k]]));
  return found.sort((a, b) => a[1] - b[1]);
}

function answerOf(look) { // what came of a look at a gap: a refusal with all that said no, or taken
  if (look.rule !== "yes") return (look.refusals ?? look.rule).replaceAll(" ", ", ");
  if (look.guard !== "yes") return look.guard;
  return look.sumo === "no" ? "refused by SUMO" : look.sumo === "yes" ? "taken" : "SUMO not asked";
}

function findingText([agent, step, quantity, value, limit, other]) {
  const [sentence, unit] = SHARED.quantities[quantity];
  return `${agent}: ${sentence}${other ? ` (${other})` : ""} ${fixed(value, 2)} ${unit}, limit ${fixed(limit, 2)}`;
}

function marksOf(scene) { // of the slider, in order of time
  const marks = [], mark = (s, agent, sign, color, line, says) => marks.push({ step: Math.round(s / scene.step_s), agent, sign, color, line, says });
  for (const agent of scene.said.agents ?? []) for (const one of agent.maneuvers) {
    const s = one.crossing_s ?? one.start_s ?? one.trigger_s, color = SHARED.faces[SHARED.policy[one.kind]];
    if (s === null || one.status === "not_feasible") continue;
    const says = `${agent.track_id}: ${words(one.kind)} ${words(one.status)}${one.reason ? ` (${words(one.reason)})` : ""}`;
    mark(s, agent.track_id, one.status === "done" ? "◆" : "✕", color, 1, says);
  }
  for (const one of scene.said.events ?? []) if (one.at_s !== null)
    mark(one.at_s, one.track_id, "★", "#000", 0, `event ${words(one.kind)} of ${one.track_id} with ${one.target_track_id}`);
  for (const one of scene.findings) mark(one[1] * scene.step_s, one[0], "▲", SHARED.highlight, 0, findingText(one));
  return marks.sort((a, b) => a.step - b.step);
}
