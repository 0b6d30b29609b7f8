// A pane: the map and the vehicles of a scene, drawn where the shared `view` looks.
const TRAIL_S = 2, LEAST_PX = 7, MIN_SCALE = 0.2, MAX_SCALE = 80, FIT_SCALE = 12, NAMES_FROM = 2.2;
const view = { x: 0, y: 0, scale: 1, fitted: "" }, looksAt = () => [view.x, view.y, view.scale].join();

class Pane {
  constructor(scene, title, { without = false } = {}) { // without: inserted ones
    const node = document.createElement("div");
    node.className = "pane", node.innerHTML = "<h2></h2><canvas></canvas><canvas></canvas>", node.firstChild.textContent = title;
    Object.assign(this, { scene, without, node, ground: node.children[1], front: node.children[2] });
  }
  setSize(wide, high, ratio) {
    Object.assign(this, { wide, high, ratio, seen: "" });
    for (const canvas of [this.ground, this.front]) [canvas.width, canvas.height] = [wide * ratio, high * ratio];
  }
  shows(track) { return !(this.without && track.inserted); }
  pixel(x, y) { return [this.wide / 2 + (x - view.x) * view.scale, this.high / 2 - (y - view.y) * view.scale]; }
  place(px, py) { return [view.x + (px - this.wide / 2) / view.scale, view.y - (py - this.high / 2) / view.scale]; }
  toMetres(context) {
    const k = view.scale * this.ratio;
    context.setTransform(k, 0, 0, -k, (this.wide * this.ratio) / 2 - view.x * k, (this.high * this.ratio) / 2 + view.y * k);
  }
  drawGround({ cells, cell }) { // only where it would look otherwise
    const key = [looksAt(), cells, cell].join();
    if (key === this.seen) return;
    this.seen = key;
    const context = this.ground.getContext("2d"), { paths } = this.scene, colors = SHARED.map, px = 1 / view.scale;
    const fill = (path, color) => { context.fillStyle = color, context.fill(path); };
    const stroke = (path, color, width = 1) => {
      Object.assign(context, { strokeStyle: color, lineWidth: width * px }), context.stroke(path);
    };
    context.setTransform(1, 0, 0, 1, 0, 0), context.fillStyle = "#fff";
    context.fillRect(0, 0, this.ground.width, this.ground.height), this.toMetres(context);
    fill(paths.ground, colors.ground), stroke(paths.ground, colors.kerb), fill(paths.bike, colors.bike);
    context.globalAlpha = 0.5, fill(paths.crossing, colors.crossing), context.globalAlpha = 1;
    if (cells) stroke(paths.cell, colors.cell, 0.7);
    stroke(paths.edge, colors.edge), context.setLineDash([4 * px, 4 * px]), stroke(paths.centre, colors.centre), context.setLineDash([]);
    if (cell === null) return;
    const ring = new Path2D();
    trace(ring, this.scene.cells[cell].ring, true), stroke(ring, SHARED.highlight, 2);
  }
  drawFront({ time, agent, trails, names }) {
    const context = this.front.getContext("2d"), { scene } = this, px = 1 / view.scale, labels = [];
    const back = trails ? Math.round(TRAIL_S / scene.step_s) : 0;
    context.setTransform(1, 0, 0, 1, 0, 0), context.clearRect(0, 0, this.front.width, this.front.height), this.toMetres(context);
    for (const track of scene.order) {
      const at = track.at = this.shows(track) ? pose(track, time, scene) : null, chosen = track.id === agent;
      if (!at) continue;
      if (back) this.drawTrail(context, track, at, back, Math.max(2.2 * px, 0.4));
      if (chosen) this.drawWhole(context, track, 1.2 * px);
      this.drawBox(context, track, at, px, chosen);
      if (chosen || (names && (rank(track) === 2 || (rank(track) > 2 && view.scale >= NAMES_FROM)))) labels.push([track, at, chosen]);
    }
    context.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    this.drawLabels(context, labels.reverse().sort((a, b) => b[2] - a[2])), this.drawScale(context);
  }
  drawTrail(context, track, at, back, width) {
    context.beginPath(), context.moveTo(at.x, at.y);
    for (let k = at.row; k >= Math.max(0, at.row - back); k -= 1) context.lineTo(track.x[k], track.y[k]);
    Object.assign(context, { globalAlpha: 0.5, strokeStyle: SHARED.faces[track.kind], lineWidth: width });
    context.stroke(), context.globalAlpha = 1;
  }
  drawWhole(context, track, width) { // the whole path, broken where the track is
    context.beginPath();
    for (const [first, length] of track.runs) for (let k = 0; k < length; k += 1) {
      const row = track.row[first + k];
      context[k ? "lineTo" : "moveTo"](track.x[row], track.y[row]);
    }
    Object.assign(context, { strokeStyle: SHARED.faces[track.kind], lineWidth: width }), context.stroke();
  }
  drawBox(context, track, at, px, chosen) { // never so small that it cannot be seen
    const larger = Math.max(1, (LEAST_PX * px) / Math.max(...track.size)), [length, width] = track.size.map((side) => side * larger);
    const edge = track.focal ? { strokeStyle: "#000", lineWidth: 2 * px } : { strokeStyle: "#333", lineWidth: 0.7 * px };
    context.save(), context.translate(at.x, at.y), context.rotate(at.heading);
    Object.assign(context, { fillStyle: SHARED.faces[track.kind], ...edge });
    context.beginPath(), context.rect(-length / 2, -width / 2, length, width), context.fill();
    context.moveTo(0, 0), context.lineTo(length / 2, 0), context.stroke();
    if (chosen) {
      context.beginPath(), context.arc(0, 0, Math.max(0.75 * length + 1, 12 * px), 0, 7);
      Object.assign(context, { strokeStyle: SHARED.highlight, lineWidth: 2 * px }), context.stroke();
    }
    context.restore();
  }
  drawLabels(context, labels) { // those that fit without overlap, the chosen one always
    const taken = [], boxes = this.scene.order.map((track) => track.at && this.pixel(track.at.x, track.at.y)).filter(Boolean);
    Object.assign(context, { font: "600 11px system-ui,sans-serif", textBaseline: "bottom", lineJoin: "round" });
    for (const [track, at, chosen] of labels) {
      const text = track.inserted ? `${track.id} ${SHARED.short[track.kind] ?? ""}` : track.id, off = chosen ? 14 : 6;
      const [x, y] = this.pixel(at.x, at.y), width = context.measureText(text).width;
      const spots = [[x + off, y - off], [x - off - width, y - off], [x + off, y + off + 11], [x - off - width, y + off + 11]];
      const apart = spots.filter(([a, b]) => taken.every(([c, d, w]) => a + width < c || c + w < a || Math.abs(b - d) > 11));
      const clear = apart.find(([a, b]) => boxes.every(([c, d]) => c < a || c > a + width || d > b + 2 || d < b - 13)), free = clear ?? apart[0];
      if (!free && !chosen) continue;
      const [a, b] = free ?? spots[0];
      taken.push([a, b, width]);
      Object.assign(context, { strokeStyle: "#fff", lineWidth: 3, fillStyle: chosen ? SHARED.highlight : "#222" });
      context.strokeText(text, a, b), context.fillText(text, a, b);
    }
  }
  drawScale(context) {
    const metres = [1, 2, 5, 10, 20, 50, 100, 200, 500].find((one) => one * view.scale > 50) ?? 1000, y = this.high - 10;
    Object.assign(context, { fillStyle: "#222", font: "11px system-ui,sans-serif" });
    context.fillRect(12, y, metres * view.scale, 2), context.fillText(`${metres} m`, 12, y - 3);
  }
  hit(px, py, time) { // the topmost vehicle within 5 pixels of its box, and the cell
    const [x, y] = this.place(px, py), spare = 5 / view.scale;
    const track = [...this.scene.order].reverse().find((one) => {
      const at = this.shows(one) && pose(one, time, this.scene);
      if (!at) return false;
      const [dx, dy, c, s] = [x - at.x, y - at.y, Math.cos(at.heading), Math.sin(at.heading)];
      return Math.abs(dx * c + dy * s) <= one.size[0] / 2 + spare && Math.abs(dy * c - dx * s) <= one.size[1] / 2 + spare;
    });
    const holds = ({ ring }) => ring.reduce((inside, [ax, ay], k) => {
      const [bx, by] = ring[(k + 3) % 4];
      return ay > y !== by > y && x < ((bx - ax) * (y - ay)) / (by - ay) + ax ? !inside : inside;
    }, false);
    return { track: track ?? null, cell: this.scene.cells.findIndex(holds) };
  }
}

function fit([{ scene, wide, high }]) { // the ground on which something moves, and the focal track, as in hid2 render
  const ends = ["x", "y"].map((axis) => scene.tracks.map((track) => [Math.min(...track[axis]), Math.max(...track[axis])]));
  const moves = (_, k) => scene.tracks[k].focal || ends.some((axis) => axis[k][1] - axis[k][0] > 5);
  const [[west, east], [south, north]] = ends.map((axis) => axis.filter(moves).flat()).map((all) => [Math.min(...all), Math.max(...all)]);
  Object.assign(view, { x: (west + east) / 2, y: (south + north) / 2 });
  view.scale = Math.min(FIT_SCALE, wide / (east - west + 30), high / (north - south + 30));
  view.fitted = looksAt();
}
function thumbnail(canvas, scene) { // whole paths on the ground
  const kept = { ...view }, pane = new Pane(scene, ""), context = canvas.getContext("2d");
  pane.setSize(canvas.width, canvas.height, 1), fit([pane]), pane.drawGround({ cells: false, cell: null });
  context.drawImage(pane.ground, 0, 0), pane.toMetres(context);
  for (const track of scene.order) pane.drawWhole(context, track, (rank(track) > 2 ? 3 : 1.5) / view.scale);
  Object.assign(view, kept);
}
