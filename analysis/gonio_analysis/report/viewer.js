"use strict";
// The interactive plot of a report. It draws what stands in the page's embedded JSON and fetches nothing.
(() => {
  const COLOURS = ["#0072B2", "#D55E00", "#009E73", "#CC79A7", "#B8860B", "#56B4E9"];
  const DASHES = ["", "7 3", "2 3", "9 3 2 3"];
  const PARTS = ["specular", "directional diffuse", "uniform diffuse"];
  const PART_DASHES = ["1 2.5", "5 2.5", "10 2.5 1 2.5", "14 4"];
  const INK = "#222222", FAINT = "#c9ced6", SOFT = "#55606e";
  const RAD = Math.PI / 180;

  // --- elements --------------------------------------------------------------------------------------------------
  function html(name, attributes, ...children) {
    const node = document.createElement(name);
    for (const [key, value] of Object.entries(attributes || {})) node.setAttribute(key, value);
    node.append(...children);
    return node;
  }
  function svg(parent, name, attributes, text) {
    const node = document.createElementNS("http://www.w3.org/2000/svg", name);
    for (const [key, value] of Object.entries(attributes || {})) node.setAttribute(key, value);
    if (text !== undefined) node.textContent = text;
    parent.append(node);
    return node;
  }
  function marker(parent, k, x, y, colour, size = 3) {
    const s = size, shape = (k + Math.floor(k / 6)) % 6; // beyond six curves a colour comes with another marker
    const paths = [
      null, `M${-s} ${-s}H${s}V${s}H${-s}Z`, `M0 ${-1.3 * s}L${1.2 * s} ${s}H${-1.2 * s}Z`,
      `M0 ${-1.4 * s}L${1.2 * s} 0L0 ${1.4 * s}L${-1.2 * s} 0Z`, `M0 ${1.3 * s}L${1.2 * s} ${-s}H${-1.2 * s}Z`,
      `M${-s} 0H${s}M0 ${-s}V${s}`,
    ];
    const at = { transform: `translate(${x.toFixed(2)} ${y.toFixed(2)})`, fill: colour };
    if (shape === 0) svg(parent, "circle", { ...at, r: s });
    else svg(parent, "path", { ...at, d: paths[shape], ...(shape === 5 ? { stroke: colour, "stroke-width": 1.8 } : {}) });
  }

  // --- numbers ---------------------------------------------------------------------------------------------------
  const raised = (power) => [...power].map((c) => "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"["-0123456789".indexOf(c)]).join("");
  const minus = (text) => text.replace(/e\+?(-?\d+)/, (_, power) => ` × 10${raised(power)}`).replace(/-/g, "\u2212");
  const digits = (value, n) => minus(Number(value).toPrecision(n));
  // value ± u, both to the second digit of u (as gonio/shown.py); a value alone to so many digits
  function withU(value, u, alone) {
    if (!(u > 0)) return digits(value, alone);
    const top = Math.max(Math.abs(value), u);
    const power = top >= 1e-4 && top < 1e6 ? 0 : Math.floor(Math.log10(top));
    const decimals = 1 - Number(u.toExponential(1).split("e")[1]) + power;
    const tens = 10 ** Math.max(-decimals, 0), places = Math.min(Math.max(decimals, 0), 15);
    const words = (x) => minus(tens > 1 ? String(Math.round(x / tens) * tens) : (x / 10 ** power).toFixed(places));
    const [one, two] = [words(value), words(u)];
    return power ? `(${one} ± ${two}) × 10${raised(String(power))}` : `${one} ± ${two}`;
  }
  const degrees = (value) => minus((Math.round(value * 100) / 100).toString()) + "°";
  function roundUp(value) {
    const power = 10 ** Math.floor(Math.log10(value));
    return [1, 1.2, 1.4, 1.6, 2, 2.5, 3, 4, 5, 6, 8, 10].find((s) => s * power >= value * 0.999) * power;
  }

  const NORMS = [
    ["mirror", "value in the mirror direction"], ["max", "largest in-plane value"],
    ["model", "model in the mirror direction"], ["none", "nothing: BRDF in 1/sr"],
  ];

  class Viewer {
    constructor(root, data) {
      Object.assign(this, { root, data, wave: data.at, norm: data.normalise, plot: data.plot || "polar", at: null });
      this.labels = new Set(data.shown);
      this.series = new Set(data.chosen);
      this.parts = false;
      this.resized = new ResizeObserver(() => this.draw());
      this.rows = this.pickable();
      this.keep = () => {}; // told of the state that a reader chose (page.js keeps it in the address)
      this.first = this.state();
      this.build();
      root.hidden = false;
    }

    // --- what a reader chose, as a short text ----------------------------------------------------------------------
    state() {
      const places = (names, chosen) => names.map((name, k) => (chosen.has(name) ? k : "")).filter((k) => k !== "").join(".");
      const { data } = this;
      return [this.plot, this.norm, this.wave, places(data.labels, this.labels),
        places([...data.points, ...data.models], this.series), ...(this.parts ? ["parts"] : [])].join("_");
    }

    restore(state) {
      const [plot, norm, wave, labels, series, parts] = state.split("_"), { data } = this;
      if (series === undefined || !data.waves[wave] || !NORMS.some(([key]) => key === norm)) return;
      const named = (names, places) => new Set(names.filter((_, k) => places.split(".").includes(String(k))));
      Object.assign(this, { plot, norm, wave: Number(wave), parts: parts === "parts" });
      this.labels = named(data.labels, labels);
      this.series = named([...data.points, ...data.models], series);
      this.again();
    }

    /** The controls and the plot anew. */
    again() {
      this.resized.disconnect();
      this.root.replaceChildren();
      this.build();
      this.draw();
    }

    chosen() {
      this.at = null;
      this.draw();
      const state = this.state();
      this.keep(state === this.first ? "" : state);
    }

    // --- the table beside it: a click on a row draws what it is about -----------------------------------------------
    pickable() {
      const near = this.root.closest(".answer") || this.root.parentElement;
      const rows = [...near.querySelectorAll("tr[data-draws]")].filter((row) => this.data.models.includes(row.dataset.draws));
      for (const row of rows) {
        const head = row.cells[0], button = html("button", { type: "button" }, ...head.childNodes);
        head.append(button);
        row.addEventListener("click", (event) => event.target.closest(".term, a") || this.pick(row.dataset.draws));
      }
      return rows;
    }

    /** One model alone. */
    pick(name) {
      for (const model of this.data.models) if (model !== name) this.series.delete(model);
      this.series.add(name);
      for (const box of this.root.querySelectorAll("[data-key=series]")) box.checked = this.series.has(box.value);
      this.chosen();
    }

    marked() {
      for (const row of this.rows) {
        const shown = this.series.has(row.dataset.draws);
        row.classList.toggle("drawn", shown);
        row.querySelector("button").setAttribute("aria-pressed", String(shown));
      }
    }

    /** Other data in place of those that are shown, of a run that goes on; what the reader has chosen stays. */
    renew(data) {
      const names = (d) => JSON.stringify([d.labels, d.points, d.models, d.moving, d.note, d.waves.map((w) => w.nm)]);
      const was = this.data, at = this.at;
      this.data = data;
      for (const name of data.shown) if (!was.labels.includes(name)) this.labels.add(name);
      if (names(was) === names(data)) {
        this.draw();
      } else {
        this.wave = Math.max(0, data.waves.findIndex((w) => w.nm === was.waves[this.wave].nm));
        this.again();
      }
      const same = (s) => s.p.angle === at.p.angle && s.line.name === at.line.name && s.line.curve.label === at.line.curve.label;
      if (at) this.point(this.spots.find(same) || null);
    }

    // --- colours: of curves; of several measurements a colour tells the measurement, and a marker the curve ----------
    get several() { return this.data.points.length > 1; }
    tone(name) { return COLOURS[this.data.points.indexOf(name) % 6]; }
    colour(label) { return this.several ? INK : COLOURS[this.data.labels.indexOf(label) % 6]; }
    of(line) { return this.several && !line.theory ? this.tone(line.name) : COLOURS[line.look % 6]; }

    // --- controls ------------------------------------------------------------------------------------------------
    build() {
      const { data, root } = this;
      const swatch = (k, colour) => {
        const box = document.createElementNS("http://www.w3.org/2000/svg", "svg");
        for (const [a, v] of [["width", 14], ["height", 14], ["viewBox", "-7 -7 14 14"], ["aria-hidden", "true"]]) {
          box.setAttribute(a, v);
        }
        marker(box, k, 0, 0, colour, 4);
        return box;
      };
      const boxes = (title, names, chosen, key) => html("fieldset", {}, html("legend", {}, title), ...names.map((name) => {
        const box = html("input", { type: "checkbox", value: name, "data-key": key });
        box.checked = chosen.has(name);
        box.addEventListener("change", () => {
          if (box.checked) chosen.add(name); else chosen.delete(name);
          this.chosen();
        });
        return html("label", {}, box, ...(key === "curve" ? [swatch(data.labels.indexOf(name), this.colour(name))] : this.several && data.points.includes(name) ? [swatch(1, this.tone(name))] : []), name);
      }));
      const choice = (title, key, options) => {
        const select = html("select", { "data-key": key }, ...options.map(([value, text]) => html("option", { value }, text)));
        select.value = String(this[key]);
        select.addEventListener("change", () => {
          this[key] = key === "wave" ? Number(select.value) : select.value;
          this.chosen();
        });
        return html("label", { class: "choice" }, title, select);
      };
      const order = [...data.labels].sort((a, b) => parseFloat(a.split("=")[1]) - parseFloat(b.split("=")[1]));
      const choices = [
        choice("Plot", "plot", [["polar", "polar"], ["log", "semilog"]]),
        choice("Divided by", "norm", NORMS.filter(([key]) => key !== "model" || data.models.length)),
      ];
      if (data.waves.length > 1) {
        choices.push(choice("Wavelength", "wave", data.waves.map((w, k) => [String(k), `${w.nm} nm`])));
      }
      if (this.partNames().length) {
        const box = html("input", { type: "checkbox", "data-key": "parts" });
        box.checked = this.parts;
        box.addEventListener("change", () => {
          this.parts = box.checked;
          this.chosen();
        });
        choices.push(html("label", {}, box, "Parts of the models"));
      }
      this.dashes = html("p", { class: "note" });
      this.stage = html("div", { class: "stage" });
      this.output = html("output", { "aria-live": "polite" });
      root.append(
        html("div", { class: "choices" }, ...choices),
        boxes("Curves", order, this.labels, "curve"),
        ...(data.points.length + data.models.length > 1 ? [boxes("Shown", [...data.points, ...data.models], this.series, "series")] : []),
        this.stage, this.dashes, this.output, ...(data.note ? [html("p", { class: "note" }, data.note)] : []),
      );
      this.resized.observe(this.stage);
    }

    // --- what is shown -------------------------------------------------------------------------------------------
    /** The divisor of a series; a curve without a value in the mirror direction is divided by its largest value. */
    divisor(curve, s) {
      if (this.norm === "none") return 1;
      if (this.norm === "model") {
        const model = curve.series.find((x) => this.series.has(x.name) && x.by.model);
        const any = model || curve.series.find((x) => x.by.model);
        return s.by.model || (any && any.by.model) || s.by.max || 1;
      }
      return s.by[this.norm] || s.by.max || 1;
    }

    /** Of all models here; each has a dash of its own. */
    partNames() {
      const every = this.data.waves.flatMap((w) => w.curves.flatMap((c) => c.series.flatMap((s) => Object.keys(s.parts || {}))));
      return [...new Set(every)].sort((a, b) => PARTS.indexOf(a) - PARTS.indexOf(b) || (a < b ? -1 : 1));
    }

    /** The parts of a model's line: numbers, one number for all, or null for what the others leave of the whole. */
    ofParts(curve, s, look, by) {
      const named = Object.entries(s.parts || {}), at = (part, k) => (part instanceof Array ? part[k] : part);
      return named.map(([name, part]) => {
        const values = s.brdf.map((whole, k) => part !== null || whole === null ? at(part, k)
          : Math.max(0, named.reduce((rest, [, other]) => rest - (other === null ? 0 : at(other, k)), whole)));
        const points = s.angle.map((angle, k) => ({ angle, brdf: values[k], u: null, value: values[k] / by, du: null }));
        const dash = PART_DASHES[this.partNames().indexOf(name) % 4];
        return { curve, look, name: `${s.name}: ${name}`, by, points: points.filter((p) => p.brdf !== null), theory: true, dash };
      });
    }

    visible() {
      const out = [];
      for (const curve of this.data.waves[this.wave].curves) {
        if (!this.labels.has(curve.label)) continue;
        const look = this.data.labels.indexOf(curve.label);
        for (const s of curve.series) {
          if (!this.series.has(s.name)) continue;
          const by = this.divisor(curve, s);
          const points = [];
          s.angle.forEach((angle, k) => {
            if (s.brdf[k] === null) return;
            const u = s.u && s.u[k] !== null ? s.u[k] : null;
            points.push({ angle, brdf: s.brdf[k], u, value: s.brdf[k] / by, du: u === null ? null : u / by });
          });
          out.push({ curve, look, name: s.name, by, points, theory: this.data.models.includes(s.name) });
          if (this.parts) out.push(...this.ofParts(curve, s, look, by));
        }
      }
      return out;
    }

    draw() {
      const width = Math.max(240, Math.round(this.stage.clientWidth));
      const lines = this.visible();
      this.spots = [];
      const picture = document.createElementNS("http://www.w3.org/2000/svg", "svg");
      const height = this.plot === "polar" ? Math.round(width * 0.5 + 44) : Math.round(Math.min(0.62 * width, 460));
      for (const [a, v] of [["viewBox", `0 0 ${width} ${height}`], ["width", width], ["height", height], ["tabindex", 0],
        ["role", "application"], ["aria-label", `${this.data.name}: BRDF over angle. Arrow keys walk along the measured values.`]]) {
        picture.setAttribute(a, v);
      }
      if (this.plot === "polar") this.polar(picture, lines, width, height);
      else this.log(picture, lines, width, height);
      if (!lines.length) svg(picture, "text", { x: width / 2, y: height / 2, "text-anchor": "middle", fill: SOFT, "font-size": 14 }, "Nothing is chosen.");
      this.cursor = svg(picture, "g", { class: "cursor", "pointer-events": "none" });
      picture.addEventListener("pointermove", (event) => this.hover(event));
      picture.addEventListener("pointerdown", (event) => this.hover(event));
      picture.addEventListener("pointerleave", () => this.point(null));
      picture.addEventListener("keydown", (event) => this.key(event));
      picture.addEventListener("blur", () => this.point(null));
      const focused = this.picture && document.activeElement === this.picture;
      this.stage.replaceChildren(picture);
      this.picture = picture;
      this.dashes.replaceChildren(...(this.parts ? this.partNames().flatMap((name, k) => {
        const line = document.createElementNS("http://www.w3.org/2000/svg", "svg");
        for (const [a, v] of [["width", 44], ["height", 10], ["aria-hidden", "true"]]) line.setAttribute(a, v);
        svg(line, "path", { d: "M6 5H38", stroke: INK, "stroke-width": 1.1, "stroke-dasharray": PART_DASHES[k % 4] });
        return [line, `${name} `];
      }) : []));
      this.marked();
      if (focused) picture.focus();
      this.point(null);
    }

    /** What the values are, in one line, or in two where `room` [px] is short. */
    label(room) {
      if (this.norm === "none") return ["BRDF [1/sr]"];
      const curves = this.data.waves[this.wave].curves.filter((curve) => this.labels.has(curve.label));
      const without = curves.filter((curve) => curve.series.some((s) => this.series.has(s.name) && !s.by[this.norm]));
      const largest = this.norm === "mirror" ? without.length : 0;
      const norm = largest && largest === curves.length ? "max" : this.norm;
      const words = [`BRDF / ${NORMS.find(([key]) => key === norm)[1]}`];
      if (largest && norm === this.norm) words.push(`${without.length} of ${curves.length} curves: / largest in-plane value`);
      return 6.5 * words.join("; ").length > room ? words : [words.join("; ")];
    }

    /** Lines, error bars and markers through `place`: (angle, value) -> [x, y], or null for what cannot be shown. */
    curves(group, lines, place) {
      const models = this.data.models.filter((m) => this.series.has(m));
      for (const line of lines) {
        const colour = this.of(line);
        let path = "", pen = "M";
        for (const p of line.points) {
          const xy = place(p.angle, p.value);
          if (xy && (line.theory || this.several)) path += `${pen}${xy[0].toFixed(2)} ${xy[1].toFixed(2)}`;
          pen = xy ? "L" : "M";
          if (xy) this.spots.push({ x: xy[0], y: xy[1], line, p });
        }
        if (line.theory) {
          svg(group, "path", { d: path || "M0 0", fill: "none", stroke: colour, "stroke-width": line.dash ? 1.1 : 1.6, "stroke-dasharray": line.dash || DASHES[models.indexOf(line.name) % 4] });
          continue;
        }
        if (this.several) svg(group, "path", { d: path || "M0 0", fill: "none", stroke: colour, "stroke-width": 0.8, "stroke-dasharray": DASHES[1 + this.data.points.indexOf(line.name) % 3] });
        for (const p of line.points) {
          const xy = place(p.angle, p.value);
          if (!xy) continue;
          if (p.du !== null) {
            const low = place(p.angle, p.value - p.du) || xy, high = place(p.angle, p.value + p.du) || xy;
            svg(group, "path", { d: `M${low[0].toFixed(2)} ${low[1].toFixed(2)}L${high[0].toFixed(2)} ${high[1].toFixed(2)}`, stroke: colour, "stroke-width": 1.2 });
          }
          marker(group, line.look, xy[0], xy[1], colour, this.stage.clientWidth < 520 ? 2.2 : 3);
        }
      }
    }

    polar(picture, lines, width, height) {
      const cx = width / 2, R = width / 2 - 36, clip = `${this.root.id}-clip`;
      const tops = lines.map((l) => Math.max(0, ...l.points.map((p) => p.value))).filter((t) => t > 0);
      const most = this.norm === "none" ? Infinity : 2.5;
      const fit = tops.filter((t) => t <= most);
      const rim = this.norm === "none" ? roundUp(Math.max(1e-12, ...tops)) : roundUp(Math.max(fit.length < tops.length ? 1.2 : 1, ...fit));
      const cut = lines.filter((l) => l.points.some((p) => p.value > rim * 1.001)).slice(0, 6);
      const above = width < 640 ? 13 * cut.length : 0; // no room beside the half-disc: the notes stand above it
      const cy = R + 24 + above;
      const words = this.label(width), below = width > 480 && words.length === 1 && 6.5 * words[0].length < 2 * R - 150 ? 31 : 46; // beside the words at both ends, or below
      const tall = height + above + 14 * (words.length - 1);
      picture.setAttribute("viewBox", `0 0 ${width} ${tall}`);
      picture.setAttribute("height", tall);
      const xy = (angle, r) => [cx + r * Math.sin(angle * RAD), cy - r * Math.cos(angle * RAD)];
      const define = svg(svg(picture, "defs"), "clipPath", { id: clip });
      svg(define, "path", { d: `M${cx - R - 1} ${cy + 1}A${R + 1} ${R + 1} 0 0 1 ${cx + R + 1} ${cy + 1}Z` });
      const step = [0.2, 0.25, 0.5, 1].find((s) => this.norm !== "none" && rim / s <= 8.01 && Math.abs(rim / s - Math.round(rim / s)) < 1e-6) || rim / 4;
      const stride = Math.ceil(30 / ((R * step) / rim)); // labels stand at least 30 px apart
      const count = Math.round(rim / step);
      for (let k = 1; k <= count; k++) {
        const t = k * step, r = (R * t) / rim;
        svg(picture, "path", { d: `M${cx - r} ${cy}A${r} ${r} 0 0 1 ${cx + r} ${cy}`, fill: "none", stroke: t > rim * 0.9999 ? INK : FAINT, "stroke-width": t > rim * 0.9999 ? 1 : 0.6 });
        for (const side of (count - k) % stride ? [] : [-1, 1]) {
          svg(picture, "text", { x: cx + side * r, y: cy + 14, "text-anchor": "middle", fill: INK, "font-size": 11 }, String(Number(t.toPrecision(3))));
        }
      }
      svg(picture, "text", { x: cx, y: cy + 14, "text-anchor": "middle", fill: INK, "font-size": 11 }, "0");
      for (let a = -90; a <= 90; a += 15) {
        const [x, y] = xy(a, R);
        svg(picture, "line", { x1: cx, y1: cy, x2: x, y2: y, stroke: a % 90 ? FAINT : a ? INK : FAINT, "stroke-width": Math.abs(a) === 90 ? 1 : 0.6 });
        if (a % 30 === 0) {
          const [tx, ty] = xy(a, R + (Math.abs(a) === 90 ? 19 : a ? 9 : 14));
          svg(picture, "text", { x: tx, y: ty + 4, "text-anchor": a % 90 === 0 ? "middle" : a < 0 ? "end" : "start", fill: INK, "font-size": 11 }, degrees(a));
        }
      }
      for (const [anchor, x, text] of [["start", cx - R, "retro side"], ["end", cx + R, "mirror side"]]) {
        svg(picture, "text", { x, y: cy + 31, "text-anchor": anchor, fill: SOFT, "font-size": 11 }, text);
      }
      words.forEach((some, k) => svg(picture, "text", { x: cx, y: cy + below + 14 * k, "text-anchor": "middle", fill: INK, "font-size": 12 }, some));
      const group = svg(picture, "g", { "clip-path": `url(#${clip})` });
      const whole = new Set();
      for (const line of lines) {
        if (whole.has(line.curve.label)) continue;
        whole.add(line.curve.label);
        const a = xy(line.curve.mirror, R), b = xy(line.curve.mirror, R + 6);
        svg(picture, "line", { x1: a[0], y1: a[1], x2: b[0], y2: b[1], stroke: this.colour(line.curve.label), "stroke-width": 3 });
      }
      this.curves(group, lines, (angle, value) => xy(angle, (R * Math.max(0, value)) / rim));
      this.spots = this.spots.filter((s) => Math.hypot(s.x - cx, s.y - cy) <= R + 1.5);
      cut.forEach((l, k) => {
        const top = Math.max(...l.points.map((p) => p.value));
        svg(picture, "text", { x: 2, y: 12 + 13 * k, fill: this.of(l), "font-size": 11 }, `${l.curve.label} ${l.name} to ${digits(top, 3)}`);
      });
    }

    log(picture, lines, width, height) {
      const left = 58, right = width - 10, top = 10, bottom = height - 44;
      const every = lines.flatMap((l) => l.points.map((p) => p.value)).filter((v) => v > 0);
      const measured = lines.filter((l) => !l.theory).flatMap((l) => l.points.map((p) => p.value)).filter((v) => v > 0);
      const low = Math.log10(Math.min(...(measured.length ? measured : every.length ? every : [0.1]))) - 0.2;
      const high = Math.log10(Math.max(...(every.length ? every : [1]))) + 0.2;
      const place = (angle, value) => value > 0 ? [left + ((angle + 90) / 180) * (right - left), bottom - ((Math.log10(value) - low) / (high - low)) * (bottom - top)] : null;
      const define = svg(svg(picture, "defs"), "clipPath", { id: `${this.root.id}-clip` });
      svg(define, "rect", { x: left, y: top, width: right - left, height: bottom - top });
      const steps = high - low < 2.2 ? [1, 2, 5] : [1];
      const every_ = Math.ceil((high - low) / 9);
      for (let power = Math.floor(low); power <= high; power++) {
        if (power % every_ && steps.length === 1) continue;
        for (const m of steps) {
          const [, y] = place(0, m * 10 ** power);
          if (y > bottom || y < top) continue;
          svg(picture, "line", { x1: left, y1: y, x2: right, y2: y, stroke: FAINT, "stroke-width": 0.6 });
          const shown = power >= -3 && power <= 3 ? String(Number((m * 10 ** power).toPrecision(1))) : null;
          const text = svg(picture, "text", { x: left - 6, y: y + 4, "text-anchor": "end", fill: INK, "font-size": 11 }, shown || (m === 1 ? "10" : `${m} × 10`));
          if (!shown) svg(text, "tspan", { dy: -5, "font-size": 9 }, minus(String(power)));
        }
      }
      for (let a = -90; a <= 90; a += 30) {
        const [x] = place(a, 1);
        svg(picture, "line", { x1: x, y1: top, x2: x, y2: bottom, stroke: FAINT, "stroke-width": 0.6 });
        svg(picture, "text", { x, y: bottom + 15, "text-anchor": "middle", fill: INK, "font-size": 11 }, degrees(a));
      }
      svg(picture, "path", { d: `M${left} ${top}V${bottom}H${right}`, fill: "none", stroke: INK });
      svg(picture, "text", { x: (left + right) / 2, y: bottom + 34, "text-anchor": "middle", fill: INK, "font-size": 12 }, `${this.data.moving}: retro side negative, mirror side positive`);
      this.label(bottom - top).forEach((some, k) => svg(picture, "text", { transform: `translate(${11 + 12 * k} ${(top + bottom) / 2}) rotate(-90)`, "text-anchor": "middle", fill: INK, "font-size": 11 }, some));
      const group = svg(picture, "g", { "clip-path": `url(#${this.root.id}-clip)` });
      this.curves(group, lines, place);
      this.spots = this.spots.filter((s) => s.y <= bottom + 1 && s.y >= top - 1);
    }

    // --- reading values ------------------------------------------------------------------------------------------
    hover(event) {
      const box = this.picture.getBoundingClientRect();
      const x = event.clientX - box.left, y = event.clientY - box.top;
      let best = null, least = 22;
      for (const s of this.spots) {
        const far = Math.hypot(s.x - x, s.y - y) + (s.line.theory ? 5 : 0);
        if (far < least) [best, least] = [s, far];
      }
      this.point(best);
    }

    key(event) {
      const pool = this.spots.some((s) => !s.line.theory) ? this.spots.filter((s) => !s.line.theory) : this.spots;
      const lines = [...new Set(pool.map((s) => s.line))];
      if (!lines.length || !["ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown", "Escape"].includes(event.key)) return;
      event.preventDefault();
      if (event.key === "Escape") return this.point(null);
      const now = this.at && pool.includes(this.at) ? this.at : null;
      const line = now ? now.line : lines[0];
      const along = (l) => pool.filter((s) => s.line === l);
      if (!now) return this.point(along(line)[0]);
      if (event.key === "ArrowLeft" || event.key === "ArrowRight") {
        const path = along(line), k = path.indexOf(now) + (event.key === "ArrowRight" ? 1 : -1);
        return this.point(path[Math.min(path.length - 1, Math.max(0, k))]);
      }
      const next = lines[(lines.indexOf(line) + (event.key === "ArrowDown" ? 1 : lines.length - 1)) % lines.length];
      return this.point(along(next).reduce((a, b) => Math.abs(a.p.angle - now.p.angle) <= Math.abs(b.p.angle - now.p.angle) ? a : b));
    }

    /** Mark one value and say it; null takes the mark away. */
    point(spot) {
      this.at = spot;
      this.cursor.replaceChildren();
      if (!spot) {
        this.output.textContent = "Point at a value, or walk along the curves with the arrow keys.";
        return;
      }
      const { line, p } = spot;
      svg(this.cursor, "circle", { cx: spot.x, cy: spot.y, r: 7, fill: "none", stroke: INK, "stroke-width": 1.6 });
      let text = `${line.curve.label}, ${this.data.moving} = ${degrees(p.angle)}, ${line.name}: ${withU(p.brdf, p.u, 5).replace(/^[^(].*±.*$/, "($&)")} sr⁻¹`;
      if (this.norm !== "none") text += `; divided: ${withU(p.value, p.du, 4)}`;
      if (!line.theory) {
        for (const s of line.curve.series) {
          if (s.name === line.name || !this.series.has(s.name)) continue;
          const k = s.angle.indexOf(p.angle);
          if (k < 0 || s.brdf[k] === null) continue;
          const off = p.u ? `, off by ${digits((s.brdf[k] - p.brdf) / p.u, 2)} u` : "";
          text += `; ${s.name}: ${digits(s.brdf[k], 5)}${off}`;
        }
      }
      this.output.textContent = `${text}.`;
    }
  }

  window.gonio = { digits, withU, degrees, viewers: [] }; // for a program that fills such a plot, and for page.js
  for (const root of document.querySelectorAll(".viewer")) {
    const data = document.getElementById(`${root.id}-data`);
    if (data) window.gonio.viewers.push(new Viewer(root, JSON.parse(data.textContent)));
    else root.show = (view) => { if (root.viewer) root.viewer.renew(view); else root.viewer = new Viewer(root, view); };
  }
})();
