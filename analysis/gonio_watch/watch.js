"use strict";
// A run as it is measured. Its journal comes as numbered events; the server tells how it stands; values and the last
// frame are fetched when they are new. Nothing can be asked of the rig from here.
(() => {
  const SVG = "http://www.w3.org/2000/svg";
  const COLOURS = ["#0072B2", "#D55E00", "#009E73", "#CC79A7", "#B8860B", "#56B4E9"];
  const MOST_LINES = 200, MOST_POINTS = 400;
  const WORDS = {
    waiting: "waiting", running: "running", suspended: "suspended", paused: "paused", ended: "ended",
    interrupted: "interrupted", failed: "failed", died: "died", silent: "silent?",
  };
  const QUANTITIES = { current_max: "highest current", voltage_min: "lowest voltage", load_max: "highest load" };
  const token = new URLSearchParams(location.search).get("token") || "";
  const $ = (id) => document.getElementById(id);
  const ask = (path, more = "") => `${path}?token=${encodeURIComponent(token)}${more}`;

  // --- what is known -------------------------------------------------------------------------------------------------
  let last, journal, steps, events, flags, health, levels, curves, run, status;
  function forget() {
    [last, journal, steps, events, flags, levels] = [0, null, 0, [], [], []];
    [health, curves, run, status] = [new Map(), null, {}, {}];
  }
  forget();

  const time = (wall) => (wall ? new Date(wall).toLocaleTimeString([], { hour: "2-digit", minute: "2-digit", second: "2-digit" }) : "");
  const day = (s) => new Date(1000 * s).toLocaleString([], { dateStyle: "short", timeStyle: "short" });
  /** A time within days: of today the hour alone. */
  function soon(s) {
    const then = new Date(1000 * s), clock = { hour: "2-digit", minute: "2-digit" }, days = (then - Date.now()) / 8.64e7;
    if (then.toDateString() === new Date().toDateString()) return then.toLocaleTimeString([], clock);
    return days < 6 ? then.toLocaleString([], { weekday: "short", ...clock }) : then.toLocaleDateString([], { dateStyle: "short" });
  }
  const degrees = (value) => `${(Math.round(value * 100) / 100).toString().replace("-", "\u2212")}°`;
  function duration(s) {
    if (s < 90) return `${s < 9.5 ? Number(s.toPrecision(2)) : Math.round(s)} s`;
    const minutes = Math.round(s / 60), hours = Math.floor(minutes / 60);
    if (minutes < 90) return `${minutes} min`;
    return hours < 48 ? `${hours} h ${String(minutes % 60).padStart(2, "0")} min` : `${Math.floor(hours / 24)} d ${hours % 24} h`;
  }
  function size(bytes) {
    const k = Math.min(4, Math.floor(Math.log10(Math.max(bytes, 1)) / 3));
    return `${Number((bytes / 1000 ** k).toPrecision(3))} ${["B", "kB", "MB", "GB", "TB"][k]}`;
  }
  function angles(a) {
    if (!a) return "";
    const dphi = (((a[3] - a[1]) % 360) + 360) % 360;
    return `θi ${degrees(a[0])}, θr ${degrees(a[2])}, Δφ ${degrees(dphi)}`;
  }

  function take(event) {
    if (event.event === "step") {
      steps += 1;
      if (event.time_s === undefined) return; // of very many steps the least is told
      const t = event.time_s / 3600; // of the rig: in simulation hours pass in minutes, and a run may rest for days
      if (event.kind !== "dark") levels.push([t, event.level]);
      for (const [device, quantity, value, unit] of event.health || []) {
        if (typeof value !== "number" || unit === "deg") continue;
        if (!health.has(quantity)) health.set(quantity, { unit, devices: new Map() });
        const of = health.get(quantity).devices;
        if (!of.has(device)) of.set(device, []);
        of.get(device).push([t, value]);
      }
      if (event.flag) flags.push(event);
      status.latest = event;
      if (event.kind !== "dark") status.shown = event;
    } else {
      events.push(event);
      if (events.length > 2 * MOST_LINES) events.splice(0, events.length - MOST_LINES);
    }
  }

  // --- drawing -------------------------------------------------------------------------------------------------------
  function text(id, value) {
    const node = $(id), said = value || "\u00a0";
    if (node.textContent !== said) node.textContent = said;
  }
  /** Rows of parts: an element's name ("" is text) and what it says; "details" is folded, with a line each of its own. */
  function list(id, rows, none) {
    const items = rows.map((parts) => {
      const item = document.createElement("li");
      for (const [name, value, lines, key] of parts) {
        if (name === "details") {
          item.append(folded(value, lines, key));
          continue;
        }
        const node = name ? document.createElement(name) : document.createTextNode(value);
        if (name) node.textContent = value;
        item.append(node);
      }
      return item;
    });
    if (!items.length) {
      const item = document.createElement("li");
      item.className = "none";
      item.textContent = none;
      items.push(item);
    }
    $(id).replaceChildren(...items);
  }
  const unfolded = new Set();
  function folded(said, lines, key) {
    const node = document.createElement("details"), head = document.createElement("summary"), rows = document.createElement("ul");
    head.textContent = said;
    rows.append(...lines.map((line) => Object.assign(document.createElement("li"), { textContent: line })));
    node.open = unfolded.has(key);
    node.addEventListener("toggle", () => unfolded[node.open ? "add" : "delete"](key));
    node.append(head, rows);
    return node;
  }
  function happened(e) {
    const points = (e.points_deg || []).map(angles), why = e.why || [];
    const parts = [["time", time(e.wall)], ["b", e.event.replaceAll("_", " ")], ["", ` ${e.text || ""}`]];
    if (why.length) parts.push(["details", "why", why, `why ${e.n}`]);
    if (points.length) parts.push(["details", "which", points, `which ${e.n}`]);
    return parts;
  }
  function svg(parent, name, attributes, said) {
    const node = document.createElementNS(SVG, name);
    for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
    if (said !== undefined) node.textContent = said;
    parent.append(node);
    return node;
  }

  /** At most `MOST_POINTS` of a series, its extremes among them. */
  function thin(points) {
    const stride = Math.ceil((2 * points.length) / MOST_POINTS);
    if (stride < 2) return points;
    const out = [];
    for (let k = 0; k < points.length; k += stride) {
      const group = points.slice(k, k + stride);
      const low = group.reduce((a, b) => (b[1] < a[1] ? b : a)), high = group.reduce((a, b) => (b[1] > a[1] ? b : a));
      out.push(...(low === high ? [low] : low[0] < high[0] ? [low, high] : [high, low]));
    }
    return out;
  }

  /** 1, 2 or 5 times a power of ten: not above a distance. */
  function even(distance) {
    const power = 10 ** Math.floor(Math.log10(distance)), part = distance / power;
    return power * (part >= 5 ? 5 : part >= 2 ? 2 : 1);
  }
  /** Series against the rig's time [h]: { name, points: [[t, value, u?]] }; `dots` where each value stands for itself. */
  function chart(root, series, { show = (v) => String(Number(v.toPrecision(3))), dots = false, floor = null, ceiling = null } = {}) {
    const every = series.flatMap((s) => s.points);
    root.replaceChildren();
    if (!every.length) {
      svg(root, "text", { x: 200, y: 65, "text-anchor": "middle" }, "Nothing yet.");
      return;
    }
    let low = Infinity, high = -Infinity, from = Infinity, to = -Infinity;
    for (const [t, v, u] of every) {
      [low, high] = [Math.min(low, v - (u || 0)), Math.max(high, v + (u || 0))];
      [from, to] = [Math.min(from, t), Math.max(to, t)];
    }
    if (floor !== null) low = Math.min(low, floor);
    if (ceiling !== null) high = Math.max(high, ceiling);
    const spare = 0.08 * (high - low) || 0.02 * Math.abs(high) || 1;
    [low, high] = [floor === low ? low : low - spare, ceiling === high ? high : high + spare];
    const left = 52, right = 392, top = 8, bottom = 106;
    const x = (t) => (to > from ? left + ((t - from) / (to - from)) * (right - left) : (left + right) / 2);
    const y = (v) => bottom - ((v - low) / (high - low)) * (bottom - top);
    const step = even((high - low) / 2.5);
    for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k += 1) {
      const v = k * step;
      svg(root, "line", { class: "axis", x1: left, x2: right, y1: y(v), y2: y(v) });
      svg(root, "text", { x: left - 5, y: y(v) + 4, "text-anchor": "end" }, show(v));
    }
    const length = (to - from) * 3600;
    if (to > from) svg(root, "text", { x: right, y: 122, "text-anchor": "end" }, `after ${duration(length)} of the rig's time`);
    series.forEach((s, k) => {
      const colour = COLOURS[k % 6], points = thin(s.points);
      if (dots) {
        for (const [t, v, u] of points) {
          if (u) svg(root, "line", { x1: x(t), x2: x(t), y1: y(v - u), y2: y(v + u), stroke: colour });
          svg(root, "circle", { cx: x(t), cy: y(v), r: 2.4, fill: colour });
        }
      } else {
        const d = points.map(([t, v], n) => `${n ? "L" : "M"}${x(t).toFixed(1)} ${y(v).toFixed(1)}`).join("");
        svg(root, "path", { class: "line", d, stroke: colour });
        const end = points[points.length - 1];
        svg(root, "circle", { cx: x(end[0]), cy: y(end[1]), r: 2.4, fill: colour });
      }
      if (series.length > 1) svg(root, "text", { x: left + 6 + 85 * (k % 4), y: top + 10 + 12 * Math.floor(k / 4) }, s.name).setAttribute("fill", colour);
    });
  }

  /** The answer, behind the state: how far it is, and what the values say. */
  function drawVerdict() {
    const one = (n, what, more) => (n ? `${n} ${n > 1 ? more : what}` : `no ${what}`);
    const visits = curves && curves.visits.length ? curves.visits[0].points : [];
    const change = visits.length > 1 ? `${Number((100 * (visits[visits.length - 1][1] / visits[0][1] - 1)).toPrecision(2))} %`.replace("-", "\u2212") : "";
    const drift = change ? `; the reference has changed by ${change} since it was first measured` : "";
    const flagged = one(flags.length, "step is flagged", "steps are flagged");
    const done = `: ${status.done || 0} of ${status.total || "?"} steps. `;
    text("verdict", steps ? `${done}${flagged[0].toUpperCase()}${flagged.slice(1)}${drift}.` : ": nothing is measured yet.");
    text("drift-says", visits.length ? `${one(visits.length, "measurement", "measurements")}${change && `, changed by ${change}`}` : "no measurement yet");
  }
  function drawStatus() {
    drawVerdict();
    const s = status, step = s.latest;
    text("name", run.name || "gonio watch");
    text("about", [run.plan, run.sample, run.rig && `rig ${run.rig}`, run.bands && run.bands.join(", "), run.asked].filter(Boolean).join(" · "));
    text("state", WORDS[s.state] || s.state || "waiting");
    $("state").dataset.state = s.state || "waiting";
    text("done", String(s.done || 0));
    text("total", s.total ? String(s.total) : "?");
    const going = typeof s.left_s === "number", sessions = s.sessions || [], ended = s.state === "ended" && sessions.length > 0;
    text("left-is", ended ? "took" : "left");
    if (ended) {
      text("left", duration(sessions.reduce((sum, [began, end]) => sum + end - began, 0)));
      text("until", `ended ${day(sessions[sessions.length - 1][1])}`);
    } else {
      text("left", going ? duration(s.left_s) : "–");
      const unsure = going && s.left_u_s >= Math.max(0.02 * s.left_s, 1) ? `± ${duration(s.left_u_s)}` : "";
      const done = going && s.state === "running" ? `done ${soon(Date.now() / 1000 + s.left_s)}` : "";
      text("until", [unsure, done].filter(Boolean).join("; "));
    }
    text("each", going && s.step_s ? `${duration(s.step_s)} a step` : "");
    text("why", s.why || "");
    $("progress").max = s.total || 1;
    $("progress").value = s.done || 0;
    document.title = `${s.done || 0}/${s.total || "?"} ${WORDS[s.state] || ""} – ${run.name || "gonio watch"}`;
    if (step) {
      text("now", step.kind === "point" ? `point ${step.point}` : step.kind === "reference" ? "reference" : step.kind);
      text("then", [angles(step.angles_deg), step.flag].filter(Boolean).join(" · "));
    }
    const shown = s.shown;
    if (shown) {
      $("level").value = Math.min(1, shown.level);
      const full = shown.level >= 0.98 ? ", saturated" : "";
      text("level-says", `${(100 * shown.level).toFixed(0)} % in ${Number(shown.exposure_s.toPrecision(3))} s${full}`);
    }
    if (step) {
      const has = run.limits_deg || step.pose_deg; // a pose has fields for axes that a rig may lack
      const axes = Object.entries(step.pose_deg).filter(([name]) => name in has).map(([name, value]) => {
        const box = document.createElement("div"), label = document.createElement("span"), b = document.createElement("b");
        [label.textContent, b.textContent] = [name, degrees(value)];
        box.append(label, b);
        return box;
      });
      $("axes").replaceChildren(...axes);
      text("axes-says", axes.map((box) => [...box.children].map((part) => part.textContent).join(" ")).join(", "));
    }
    text("sessions-say", sessions.length ? String(sessions.length) : "none yet");
    list("sessions", (s.sessions || []).slice(-50).map(([began, ended, count], k) => [["b", `${k + 1}`], ["", ` ${day(began)}, ${duration(ended - began)}, ${count} steps`]]), "None yet.");
    const need = s.needed_bytes ? `; about ${size(s.needed_bytes)} still needed` : "";
    text("disk", s.free_bytes ? `${size(s.free_bytes)} free on the disk${need}` : "");
    $("disk").classList.toggle("short", Boolean(s.needed_bytes && s.needed_bytes > s.free_bytes));
  }

  function drawLists() {
    drawVerdict();
    text("flag-count", flags.length ? String(flags.length) : "nothing");
    const newest = events[events.length - 1];
    text("events-say", newest ? `${newest.event.replaceAll("_", " ")} ${time(newest.wall)}` : "nothing yet");
    const out = (run.left_out || []).reduce((sum, [, , count]) => sum + count, 0);
    text("left-out-says", run.left_out ? `${out || "no"} points` : "nothing is known of the plan yet");
    list("flags", flags.slice(-MOST_LINES).reverse().map((e) => [["time", time(e.wall)], ["b", e.flag], ["", ` step ${e.step}${e.point === null ? "" : `, point ${e.point}`} ${angles(e.angles_deg)}`]]), "Nothing.");
    list("events", events.slice(-MOST_LINES).reverse().map(happened), "Nothing yet.");
    list("left-out", (run.left_out || []).map(([flag, reason, count]) => [["b", `${count} ${flag.replaceAll("_", " ")}`], ["", reason ? `: ${reason}` : ""]]), run.left_out ? "Nothing." : "Nothing is known of the plan yet.");
  }

  function drawCharts() {
    drawVerdict();
    text("levels-says", levels.length ? `last ${Math.round(100 * levels[levels.length - 1][1])} %, highest ${Math.round(100 * levels.reduce((most, [, level]) => Math.max(most, level), 0))} %` : "no step yet");
    chart($("levels"), [{ name: "level", points: levels }], { show: (v) => `${Math.round(100 * v)} %`, dots: levels.length < 200, floor: 0, ceiling: 1 });
    const visits = (curves ? curves.visits : []).map((v) => ({ name: v.name, points: v.points.map(([t, level, u]) => [t, 100 * (level - 1), u && 100 * u]) }));
    chart($("drift"), visits, { show: (v) => `${Number(v.toPrecision(3))} %`.replace("-", "\u2212"), dots: true });
    const wanted = [...health.entries()].filter(([name]) => !(health.has(`${name}_max`) || health.has(`${name}_min`)));
    const figures = wanted.map(([name, { unit, devices }]) => {
      const figure = document.createElement("figure"), said = document.createElement("figcaption");
      const picture = document.createElementNS(SVG, "svg");
      picture.setAttribute("viewBox", "0 0 400 130");
      picture.setAttribute("class", "chart");
      const now = [...devices].map(([device, points]) => `${device} ${Number(points[points.length - 1][1].toPrecision(4))}`).join(", ");
      said.textContent = `${QUANTITIES[name] || name.replaceAll("_", " ")}${unit ? ` [${unit === "C" ? "°C" : unit}]` : ""}: ${now}`;
      chart(picture, [...devices].map(([device, points]) => ({ name: device, points })));
      figure.append(said, picture);
      return figure;
    });
    text("devices-say", figures.length ? `${figures.length} quantities` : steps ? "this rig tells nothing" : "nothing yet");
    if (figures.length) $("health").replaceChildren(...figures);
    else text("no-health", steps ? "This rig tells nothing of its devices." : "Nothing yet.");
  }

  // dark blue over green to yellow: equal steps of log BRDF look like equal steps (after viridis)
  const SCALE = [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]];
  function colour(part) {
    const at = Math.max(0, Math.min(0.9999, part)) * (SCALE.length - 1), k = Math.floor(at);
    return `rgb(${SCALE[k].map((c, n) => Math.round(c + (at - k) * (SCALE[k + 1][n] - c))).join(",")})`;
  }
  function drawMap() {
    const maps = curves ? curves.maps : [];
    $("map-section").hidden = !run.out_of_plane;
    const select = $("map-of"), names = maps.map((m) => m.label);
    if ([...select.options].map((o) => o.value).join() !== names.join()) {
      const chosen = names.includes(select.value) ? select.value : names[names.length - 1];
      select.replaceChildren(...names.map((name) => new Option(name, name)));
      if (chosen) select.value = chosen;
    }
    select.hidden = !names.length;
    const root = $("map"), map = maps.find((m) => m.label === select.value);
    root.replaceChildren();
    const R = 165;
    for (const theta of [30, 60, 90]) {
      svg(root, "circle", { class: "rim", cx: 200, cy: 200, r: (R * theta) / 90 });
      svg(root, "text", { x: 203, y: 200 - (R * theta) / 90 - 3 }, `${theta}°`);
    }
    for (const [x, y, said] of [[395, 190, "mirror"], [5, 190, "retro"]]) svg(root, "text", { x, y, "text-anchor": x > 200 ? "end" : "start" }, said);
    if (!map) {
      text("map-says", "Nothing out of the plane yet.");
      return;
    }
    const logs = map.points.filter((p) => p[2] > 0).map((p) => Math.log10(p[2]));
    const low = logs.reduce((a, b) => Math.min(a, b), Infinity), high = logs.reduce((a, b) => Math.max(a, b), -Infinity);
    for (const [theta, dphi, value] of map.points) {
      const phi = ((dphi - 180) * Math.PI) / 180, r = (R * theta) / 90; // the mirror direction to the right
      const fill = value > 0 ? colour(high > low ? (Math.log10(value) - low) / (high - low) : 0.5) : "none";
      const dot = svg(root, "circle", { cx: 200 + r * Math.cos(phi), cy: 200 - r * Math.sin(phi), r: map.points.length > 400 ? 3 : 6, fill, stroke: "#888", "stroke-width": 0.4 });
      svg(dot, "title", {}, `θr ${degrees(theta)}, Δφ ${degrees(dphi)}: ${value.toPrecision(4)} 1/sr`);
    }
    if (logs.length) text("map-says", `${map.label}: ${(10 ** low).toPrecision(2)} to ${(10 ** high).toPrecision(2)} 1/sr`);
  }
  $("map-of").addEventListener("change", drawMap);

  // --- when it is drawn: at once, and then at most every quarter of a second --------------------------------------------
  const dirty = new Set();
  let due = 0;
  function draw(...what) {
    for (const name of what) dirty.add(name);
    if (!due) due = setTimeout(paint, dirty.has("status") ? 0 : 60);
  }
  function paint() {
    const now = new Set(dirty);
    dirty.clear();
    if (now.has("status")) drawStatus();
    if (now.has("lists")) drawLists();
    if (now.has("charts")) drawCharts();
    if (now.has("map")) drawMap();
    due = setTimeout(() => {
      due = 0;
      if (dirty.size) draw();
    }, 150);
  }

  // --- requests go through a worker: what fails in a page's own name fills its console ----------------------------------
  const WORK = `onmessage = async ({ data: [id, url, method] }) => {
    try {
      const answer = await fetch(url, { method, cache: "no-store" });
      postMessage([id, answer.status, answer.ok ? await answer.blob() : null]);
    } catch {
      postMessage([id, 0, null]);
    }
  };`;
  const worker = new Worker(URL.createObjectURL(new Blob([WORK], { type: "text/javascript" })));
  const waiting = new Map();
  worker.addEventListener("message", ({ data: [id, code, body] }) => {
    waiting.get(id)({ code, body });
    waiting.delete(id);
  });
  let requests = 0;
  /** The status code of an answer (0 where none came) and its body, a blob. */
  function get(path, method = "GET") {
    return new Promise((done) => {
      waiting.set(requests += 1, done);
      worker.postMessage([requests, new URL(path, location.href).href, method]);
    });
  }

  // --- values and the last frame ---------------------------------------------------------------------------------------
  let fetching = false, newest = 0, fetched = 0;
  async function fetchCurves() {
    if (fetching || fetched === newest) return;
    fetching = true;
    const version = newest, { code, body } = await get(ask("curves", `&v=${version}`));
    if (code === 200) {
      curves = JSON.parse(await body.text());
      fetched = version;
      if (curves.view) {
        $("no-curves").hidden = true;
        $("curves").show(curves.view);
      }
      text("behind", curves.says);
      text("no-curves", curves.says.includes("not reduced yet") ? "The values are being worked out." : "Two points of a curve make a plot.");
      draw("charts", "map");
    }
    fetching = false;
    if (connected && code === 200) fetchCurves();
  }
  let picture = "", loading = false;
  async function loadFrame() {
    const name = status.frame;
    if (!name || name === picture || loading || !connected) return;
    loading = true;
    const { code, body } = await get(ask("frame", `&v=${encodeURIComponent(name)}`));
    if (code === 200) {
      const shown = $("frame"), before = shown.src;
      shown.src = URL.createObjectURL(body);
      if (before) URL.revokeObjectURL(before);
      shown.hidden = false;
      $("no-frame").hidden = true;
      text("frame-says", `step ${status.frame_step}, ${name}; outline: what is averaged; red: saturated`);
    }
    if (code) picture = name;
    loading = false;
    if (code) setTimeout(loadFrame, 200);
  }

  // --- the stream: one a tab, none while it is hidden (a browser has six connections for all tabs) ----------------------
  let source = null, connected = false, again = 0;
  function serverIs(lost, said) {
    $("server").className = lost ? "lost" : "live";
    text("server", said);
  }
  function close() {
    clearTimeout(again);
    if (source) source.close();
    [source, connected] = [null, false];
  }
  /** A hidden tab takes what is new, and closes its stream. */
  function closeIfHidden() {
    if (!document.hidden || !source || status.events === undefined || last < status.events) return;
    close();
    again = setTimeout(open, 20000);
  }
  /** Ask every second whether the server is there again. */
  function seek(said) {
    close();
    serverIs(true, said);
    const look = async () => {
      const { code } = await get(ask("events"), "HEAD");
      if (source) return;
      if (code === 200) open();
      else again = setTimeout(look, 1000);
      if (code === 403) serverIs(true, "this page's address is an old one: open the one that gonio watch prints");
    };
    again = setTimeout(look, 1000);
  }
  function open() {
    close();
    const own = new EventSource(ask("events", `&last-event-id=${last}`));
    source = own;
    const on = (kind, heard) => own.addEventListener(kind, (message) => { if (own === source) heard(JSON.parse(message.data), message); });
    own.addEventListener("open", () => {
      if (own !== source) return;
      connected = true;
      serverIs(false, "live");
    });
    on("hello", (data) => {
      const other = journal !== null && journal !== data.journal;
      if (other) { // another journal is in its place: all is read anew
        forget();
        draw("status", "lists", "charts", "map");
      }
      journal = data.journal;
      if (other) open();
    });
    on("journal", (data, message) => {
      const number = Number(message.lastEventId);
      if (number <= last) return;
      last = number;
      take(data);
      draw("status", "charts");
      if (data.event !== "step" || data.flag) draw("lists");
      closeIfHidden();
    });
    on("run", (data) => { run = data; draw("status", "lists", "map"); });
    on("status", (data) => {
      status = { ...data, latest: status.latest, shown: status.shown };
      draw("status");
      loadFrame();
      closeIfHidden();
    });
    on("curves", (data) => { newest = data.version; fetched = fetched === newest ? -1 : fetched; fetchCurves(); });
    on("problem", (data) => text("behind", data.text));
    on("bye", () => seek("the server has ended; start gonio watch again, and this page goes on"));
    own.addEventListener("error", () => { if (own === source) seek("the server does not answer; asking again"); });
  }
  document.addEventListener("visibilitychange", () => {
    if (document.hidden) closeIfHidden();
    else if (!source && $("server").className !== "lost") open();
  });
  window.addEventListener("pagehide", close);
  window.addEventListener("pageshow", () => { if (!source) open(); });
  draw("status", "lists", "charts", "map");
  open();
  window.gonioWatch = { get last() { return last; }, get steps() { return steps; }, get state() { return status.state; } };
})();
