"use strict";
const token = new URLSearchParams(location.search).get("token") || "";
const $ = id => document.getElementById(id);
const SVG = "http://www.w3.org/2000/svg";
const KINDS = [
  ["axis", "optical axis"], ["centre", "sample's centre, by the rig file"], ["sample", "measured region"],
  ["reference", "reference's region"], ["beam", "lamp's beam, by the rig file"], ["spot", "spot of light, found"],
  ["box", "focus measured here"]];
const SILENT_S = 4;      // beyond the exposure: the camera is late
const DEAF_S = 9;        // the server says every three seconds that it lives

let newest = null;      // what was told last
let told = 0;           // when [ms]
let waiting = null;     // the frame to be fetched after the one that is on its way
let busy = false;
let heard = performance.now();
let lost = false;       // the server does not answer
let ended = false;

function element(name, attributes, parent) {
  const made = document.createElementNS(SVG, name);
  for (const key in attributes) made.setAttribute(key, attributes[key]);
  if (parent) parent.appendChild(made);
  return made;
}
function text(id, said) {
  if ($(id).textContent !== said) $(id).textContent = said;
}
function show(id, said) {
  $(id).hidden = !said;
  text(id, said || "");
}
function classes(id, names) {
  if ($(id).className !== names) $(id).className = names;
}
function digits(x, n) {
  if (x === null || x === undefined) return "–";
  return (Number(x.toFixed(n)) + 0).toFixed(n);
}
function short(x, n = 3) {
  return x === null ? "–" : String(Number(x.toPrecision(n)));
}
function seconds(s) {
  return s < 0.1 ? short(1e3 * s) + " ms" : short(s) + " s";
}
function facts(id, rows) {
  const list = $(id), said = JSON.stringify(rows);
  if (list.dataset.said === said) return;
  list.dataset.said = said;
  list.replaceChildren(...rows.flatMap(([name, value]) => {
    const dt = document.createElement("dt"), dd = document.createElement("dd");
    dt.textContent = name;
    dd.textContent = value;
    return [dt, dd];
  }));
}

// ---- pictures ----

function fetchFrame(look) {
  waiting = look;
  if (busy) return;
  busy = true;
  const mine = waiting;
  waiting = null;
  const load = (path, canvas, smooth) => new Promise(done => {
    const image = new Image();
    image.onload = () => {
      if (canvas.width !== image.width || canvas.height !== image.height) {
        canvas.width = image.width;
        canvas.height = image.height;
      }
      const brush = canvas.getContext("2d");
      brush.imageSmoothingEnabled = smooth;
      brush.drawImage(image, 0, 0);
      done(true);
    };
    image.onerror = () => done(false);
    image.src = `${path}?n=${mine.n}&token=${encodeURIComponent(token)}`;
  });
  Promise.all([load("frame", $("picture"), true), load("zoom", $("zoom"), false)]).then(got => {
    if (got[0]) drawOverlay($("overlay"), mine, [-0.5, -0.5, mine.width, mine.height], true);
    if (got[1]) {
      const [c, r, w, h] = mine.picture.zoom_box;
      drawOverlay($("zoom-overlay"), mine, [c - 0.5, r - 0.5, w, h], false);
    }
    document.body.dataset.frame = mine.n;
    busy = false;
    if (waiting) fetchFrame(waiting);
  });
}

function drawOverlay(svg, look, [x, y, w, h], whole) {
  const p = look.predicted, fresh = document.createDocumentFragment();
  svg.setAttribute("viewBox", `${x} ${y} ${w} ${h}`);
  const line = (kind, d) => {
    if (kind !== "box") element("path", {d, class: "halo"}, fresh);
    element("path", {d, class: `line ${kind}`}, fresh);
  };
  const ring = places => "M" + places.map(([c, r]) => `${c} ${r}`).join("L") + "Z";
  const arm = Math.max(w, h) / (whole ? 14 : 8), gap = arm / 4;
  const cross = ([c, r], a, g) => `M${c - a} ${r}H${c - g}M${c + g} ${r}H${c + a}M${c} ${r - a}V${r - g}M${c} ${r + g}V${r + a}`;
  const there = new Set(["axis"]);
  const add = (kind, d) => { line(kind, d); there.add(kind); };
  if (whole) {
    const [bx, by, bw, bh] = look.focus.box;
    add("box", `M${bx} ${by}h${bw}v${bh}h${-bw}Z`);
  }
  for (const kind of ["sample", "reference", "beam"]) if (p[kind]) add(kind, ring(p[kind]));
  if (look.spot) {
    const s = look.spot, a = s.angle_deg * Math.PI / 180, c = Math.cos(a), n = Math.sin(a);
    const [u, v] = [s.major_px / 2, s.minor_px / 2];
    const d = `M${s.column - u * c} ${s.row - u * n}L${s.column + u * c} ${s.row + u * n}M${s.column + v * n} ${s.row - v * c}L${s.column - v * n} ${s.row + v * c}`;
    if (whole) element("path", {d, class: "line spot thin"}, fresh);
    add("spot", ring(s.outline));
    line("spot", `M${s.column - gap / 2} ${s.row}h${gap}M${s.column} ${s.row - gap / 2}v${gap}`);
  }
  line("axis", cross(p.axis, arm, gap));
  if (p.centre) {
    const [c, r] = p.centre, k = gap * 1.4;
    add("centre", `M${c - k} ${r - k}L${c + k} ${r + k}M${c + k} ${r - k}L${c - k} ${r + k}`);
  }
  svg.replaceChildren(fresh);
  if (whole) legend(there);
}

function legend(there) {
  const said = [...there].sort().join();
  if ($("legend").dataset.said === said) return;
  $("legend").dataset.said = said;
  $("legend").replaceChildren(...KINDS.filter(([kind]) => there.has(kind)).map(([kind, name]) => {
    const item = document.createElement("li"), key = element("svg", {viewBox: "0 0 26 14"});
    const d = kind === "axis" ? "M13 1V5M13 9V13M5 7H10M16 7H21" : kind === "centre" ? "M8 2L18 12M18 2L8 12" : "M3 7H23";
    element("path", {d, class: `line ${kind}`}, key);
    item.append(key, name);
    return item;
  }));
}

// ---- numbers ----

function tell(look) {
  newest = look;
  told = performance.now();
  text("rig", `Alignment of ${look.rig}`);
  document.title = `Alignment of ${look.rig}`;
  show("doing", look.doing && look.doing + " …");
  text("rate", `band ${look.band}` + (look.fps === null ? "" : `, ${digits(look.fps, 1)} frames a second`));
  show("without", look.predicted.why && `No region of the sample: ${look.predicted.why}`);
  text("shown", `White is ${short(look.picture.shown_white_dn)} DN above black. Saturated pixels are red.`);
  exposure(look);
  focus(look);
  histogram(look);
  spot(look);
  const angles = look.angles_deg ? Object.entries(look.angles_deg).map(([name, a]) => [name, digits(a, 2) + "°"]) : [];
  const d = look.directions_deg;
  if (d) angles.push(["θᵢ, φᵢ", `${digits(d.theta_i, 2)}°, ${digits(d.phi_i, 2)}°`], ["θᵣ, φᵣ", `${digits(d.theta_r, 2)}°, ${digits(d.phi_r, 2)}°`]);
  facts("angles", angles);
  const zeros = Object.entries(look.zeros_deg).map(([name, z]) => `${name} ${digits(z, 3)}°`);
  text("zeros", zeros.length ? `Zeros in ${look.zeros_in}: ${zeros.join(", ")}. They hold from the next command on.` : "");
  const [, , w, h] = look.picture.zoom_box;
  text("zoom-note", `${w} × ${h} pixels of the frame`);
  lamp();
}

function exposure(look) {
  const a = look.advice, bad = /saturated|too bright/.test(a.text);
  text("advice", a.text);
  classes("advice", a.text === "good" ? "good" : bad ? "bad" : "");
  classes("level", "level" + (bad ? " bad" : ""));
  $("level").querySelector(".fill").style.width = `${100 * Math.min(Math.max(a.level, 0), 1)}%`;
  $("level").querySelector(".mark").style.left = `${100 * a.target}%`;
  const where = look.predicted.region_pixels === null ? "frame" : "region";
  text("exposure", `${seconds(look.exposure_s)}; brightest pixel of the ${where} ${digits(100 * a.level, 1)} %, wanted ${digits(100 * a.target, 0)} %` +
    (Math.abs(a.exposure_s / look.exposure_s - 1) > 0.02 ? `, at ${seconds(a.exposure_s)}` : ""));
  const n = look.noise;
  text("noise", n === null ? "noise: " + (look.saturated_in_region ? "hidden by saturation" : "waiting for two frames of one scene") :
    `noise ${short(n.dn)} DN a pixel (camera's data: ${short(n.expected_dn)})` +
    (n.u_rel === null ? "; no signal" : `; u of the region's mean ${short(100 * n.u_rel, 2)} % a frame`));
}

function focus(look) {
  const f = look.focus;
  text("focus", f.value === null ? f.why : `${digits(100 * f.value / f.best, 0)} % of the best`);
  classes("focus", f.value === null ? "none" : f.value > 0.98 * f.best ? "good" : "");
  text("focus-note", f.value === null
    ? (f.best === null ? "" : `best ${short(f.best)}`)
    : `${short(f.value)} ± ${short(f.u, 1)} a pixel, best ${short(f.best)}`);
  const svg = $("curve"), fresh = document.createDocumentFragment(), top = f.best === null ? 1 : 1.08 * f.best;
  const x = t => 320 * (1 + t / 60), y = v => 82 - 78 * v / top;
  if (f.best !== null) element("path", {d: `M0 ${y(f.best)}H320`, class: "rule"}, fresh);
  let d = "", pen = false;
  for (const [t, v] of f.history) {
    if (v !== null) d += `${pen ? "L" : "M"}${x(t).toFixed(1)} ${y(v).toFixed(1)}`;
    pen = v !== null;
  }
  element("path", {d: d || "M0 0", class: "trace"}, fresh);
  svg.replaceChildren(fresh);
}

function histogram(look) {
  const svg = $("histogram"), fresh = document.createDocumentFragment();
  const top = Math.log10(1 + Math.max(...look.levels.flatMap(l => l.counts)));
  for (const l of look.levels) {
    const step = 320 / l.counts.length;
    let d = "M0 96";
    l.counts.forEach((n, k) => { d += `V${(96 - 92 * Math.log10(1 + n) / top).toFixed(1)}H${((k + 1) * step).toFixed(1)}`; });
    element("path", {d: d + "V96Z", class: `bars ${l.channel}`}, fresh);
  }
  const x = dn => 320 * dn / (look.white_dn + 1);
  element("path", {d: `M${x(look.black_dn)} 0V96`, class: "rule"}, fresh);
  element("path", {d: `M${x(look.saturated_dn)} 0V96`, class: "rule full"}, fresh);
  svg.replaceChildren(fresh);
  text("left", "0 DN");
  text("right", `${look.white_dn} DN`);
  const counts = look.levels.map(l => (l.channel === "mono" ? "" : l.channel + " ") + l.saturated);
  text("saturation", `saturated pixels: ${counts.join(", ")}` +
    (look.saturated_in_region === null ? "" : `; ${look.saturated_in_region} in the region`));
}

function spot(look) {
  const s = look.spot;
  classes("spot", s === null ? "none" : "");
  if (s === null) {
    text("spot", look.spot_said);
    facts("spot-facts", []);
    text("spot-note", "");
    return;
  }
  const off = s.from_centre_px, mm = s.from_centre_mm, size = s.axes_mm;
  const signed = (x, n) => (Number(x.toFixed(n)) >= 0 ? "+" : "−") + digits(Math.abs(x), n);
  text("spot", off === null ? `at column ${digits(s.column, 1)}, row ${digits(s.row, 1)}`
    : `${digits(Math.hypot(...off), 1)} px from the centre`);
  const rows = [["place [px]", `${digits(s.column, 1)}, ${digits(s.row, 1)}`]];
  if (off) rows.push(["off [px]", `${signed(off[0], 1)}, ${signed(off[1], 1)}`]);
  if (mm && mm[0] !== null && mm[1] !== null) rows.push(["off [mm]", `${signed(mm[0], 3)}, ${signed(mm[1], 3)}`]);
  rows.push(["axes [px]", `${digits(s.major_px, 1)} × ${digits(s.minor_px, 1)}`]);
  if (size && size[0] !== null && size[1] !== null) rows.push(["axes [mm]", `${digits(size[0], 2)} × ${digits(size[1], 2)}`]);
  facts("spot-facts", rows);
  text("spot-note", "Outline at half of its height. " + (look.spot_said ? look.spot_said[0].toUpperCase() + look.spot_said.slice(1) + "." : ""));
}

function lamp() {
  if (ended) return;
  if (lost || performance.now() - heard > 1000 * DEAF_S) {
    text("lamp", "lamp: not known");
    classes("lamp", "badge soon");
    show("state", "no connection: look at the terminal");
    show("doing", "");
    return;
  }
  if (newest === null) return;
  const gone = (performance.now() - told) / 1000, l = newest.lamp;
  const left = l.left_s === null ? null : Math.max(l.left_s - gone, 0);
  const level = l.level === null ? "" : ` at ${short(l.level)}`;
  text("lamp", left === null ? "lamp dark" + (l.why_dark ? `: ${l.why_dark}` : "") : `lamp lit${level}, dark in ${Math.ceil(left)} s`);
  classes("lamp", "badge" + (left === null ? "" : left < 10 ? " lit soon" : " lit"));
  const late = gone - newest.exposure_s;
  show("state", late > SILENT_S && !newest.doing ? `no frame for ${Math.round(gone)} s` : "");
}

// ---- the stream ----

let stream = null;
function open() {
  if (stream || ended) return;
  stream = new EventSource(`events?token=${encodeURIComponent(token)}`);
  stream.addEventListener("open", () => { lost = false; heard = performance.now(); });
  stream.addEventListener("error", () => { lost = !ended; lamp(); });
  stream.addEventListener("beat", () => { heard = performance.now(); });
  stream.addEventListener("look", event => {
    heard = performance.now();
    const look = JSON.parse(event.data);
    tell(look);
    fetchFrame(look);
  });
  stream.addEventListener("end", event => {
    ended = true;
    waiting = null;
    close();
    show("doing", "");
    text("lamp", JSON.parse(event.data).dark ? "lamp dark" : "whether the lamp is dark is not known: look at it");
    classes("lamp", "badge" + (JSON.parse(event.data).dark ? "" : " soon"));
    show("state", "the session has ended");
  });
}
function close() {
  if (stream) stream.close();
  stream = null;
}
document.addEventListener("visibilitychange", () => document.hidden ? close() : open());
setInterval(lamp, 250);
open();
