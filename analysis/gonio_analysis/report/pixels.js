"use strict";
// A map under the cursor: the values of a pixel, and its fitted model and measured values as curves of the interactive
// plot. It draws what stands in the page's embedded JSON and fetches nothing.
(() => {
  const RAD = Math.PI / 180;
  const { digits, withU, degrees } = window.gonio;

  function html(name, attributes, ...children) {
    const node = document.createElement(name);
    for (const [key, value] of Object.entries(attributes || {})) node.setAttribute(key, value);
    node.append(...children);
    return node;
  }

  // --- numbers ---------------------------------------------------------------------------------------------------
  function bytes(text) {
    const found = atob(text), out = new Uint8Array(found.length);
    for (let k = 0; k < out.length; k++) out[k] = found.charCodeAt(k);
    return out;
  }
  /** Numbers as gonio_analysis.report.map_view packs them. */
  function unpacked({ scale, low, high, data }) {
    const view = new DataView(bytes(data).buffer), out = new Float64Array(view.byteLength / 2);
    for (let k = 0; k < out.length; k++) {
      const code = view.getUint16(2 * k, true), place = (code - 1) / 65534;
      out[k] = code === 0 ? NaN : scale === "linear" ? low + (high - low) * place : low * (high / low) ** place;
    }
    return out;
  }

  // --- the models in the plane of incidence: as gonio.models has them; angles in radians, mirror side positive ------
  function fresnel(c, n, k) {
    const c2 = c * c, s2 = 1 - c2, re = n * n - k * k - s2, both = Math.hypot(re, 2 * n * k);
    const twice = 2 * c * Math.sqrt(Math.max(0, (both + re) / 2));
    const rs = (both - twice + c2) / (both + twice + c2);
    return 0.5 * rs * (1 + (c2 * both - twice * s2 + s2 * s2) / (c2 * both + twice * s2 + s2 * s2));
  }
  function facet(ti, tr) { // of a half-vector in the plane
    const alpha = (tr - ti) / 2, half = (ti + tr) / 2, ci = Math.cos(ti), cr = Math.cos(tr), nh = Math.cos(alpha), vh = Math.cos(half);
    return { ci, cr, nh, vh, tan2: Math.tan(alpha) ** 2, G: Math.min(1, (2 * nh * cr) / vh, (2 * nh * ci) / vh) };
  }
  const MODELS = {
    "cook-torrance"(p, ti, tr) {
      const f = facet(ti, tr), D = Math.exp(-f.tan2 / (p.m * p.m)) / (p.m * p.m * f.nh ** 4);
      return ((1 - p.s) * p.diffuse_albedo + (p.s * D * fresnel(f.vh, p.ior, p.k) * f.G) / (f.ci * f.cr)) / Math.PI;
    },
    ggx(p, ti, tr) {
      const f = facet(ti, tr), a2 = p.alpha * p.alpha;
      const D = 1 / (Math.PI * a2 * f.nh ** 4 * (1 + f.tan2 / a2) ** 2);
      const smith = (t) => 0.5 * (Math.sqrt(1 + a2 * Math.tan(t) ** 2) - 1);
      return (D * fresnel(f.vh, p.ior, p.k)) / ((1 + smith(ti) + smith(tr)) * 4 * f.ci * f.cr) + p.diffuse_albedo / Math.PI;
    },
    blinn(p, ti, tr) {
      const f = facet(ti, tr), c2 = p.c * p.c, D = (c2 / (f.nh * f.nh * (c2 - 1) + 1)) ** 2;
      return (p.k_d + (p.k_s * D * fresnel(f.vh, p.ior, p.k) * f.G) / (f.ci * f.cr)) / Math.PI;
    },
    "oren-nayar"(p, ti, tr) { // the functional form, eqs. 14 to 16
      const s2 = (p.sigma_deg * RAD) ** 2, side = tr > 0 ? -1 : 1, a = Math.max(ti, Math.abs(tr)), b = Math.min(ti, Math.abs(tr));
      const bend = (2 * b) / Math.PI, c2 = ((0.45 * s2) / (s2 + 0.09)) * (Math.sin(a) - (side < 0 ? bend ** 3 : 0));
      const once = (p.albedo / Math.PI) * (1 - (0.5 * s2) / (s2 + 0.33) + side * c2 * Math.tan(b));
      return once + ((0.17 * p.albedo * p.albedo) / Math.PI) * (s2 / (s2 + 0.13)) * (1 - side * bend * bend);
    },
  };
  window.gonio.models = MODELS;

  class Pixels {
    constructor(root, data) {
      Object.assign(this, { root, data, at: null, held: false });
      this.layers = data.layers.map((l) => ({ ...l, values: unpacked(l.value), us: l.u ? unpacked(l.u) : null }));
      this.kinds = bytes(data.kinds.data);
      if (data.measured) {
        const m = data.measured;
        this.measured = { ...m, values: unpacked(m.brdf), us: bytes(m.u) };
      }
      this.drawn = data.drawn && { ...data.drawn, values: unpacked(data.drawn.brdf) };
      this.plot = root.querySelector(".viewer");
      this.build();
      root.hidden = false;
      this.choose(0);
      this.to(data.rows >> 1, data.cols >> 1);
    }

    build() {
      const { data, layers } = this;
      this.shown = layers.flatMap((l) => [
        { text: l.label, values: l.values, low: l.low, high: l.high, palette: l.name === "misfit" ? "cividis" : "viridis" },
        ...(l.us ? [{ text: `u of ${l.label}`, values: l.us, low: l.u.low, high: l.u.high, palette: "cividis" }] : []),
      ]);
      this.shown.push({ text: "flags" });
      const select = html("select", { "data-key": "layer" }, ...this.shown.map((l, k) => html("option", { value: k }, l.text)));
      select.addEventListener("change", () => this.choose(Number(select.value)));
      this.canvas = html("canvas", { width: data.cols, height: data.rows });
      this.spot = html("div", { class: "spot" });
      this.stage = html("div", { class: "stage", tabindex: 0, role: "application",
        "aria-label": "Map: point at a pixel, or walk with the arrow keys." }, this.canvas, this.spot);
      this.stage.style.maxWidth = `${Math.min(520, (460 * data.cols) / data.rows)}px`;
      this.bar = html("div", { class: "bar" });
      this.low = html("span"); this.high = html("span");
      const most = data.width_mm / 3.5, power = 10 ** Math.floor(Math.log10(most));
      const length = Math.max(...[1, 2, 5].filter((s) => s * power <= most).map((s) => s * power));
      const ruler = html("div", { class: "ruler" }, html("i"), `${Number(length.toPrecision(1))} mm`);
      ruler.firstChild.style.width = `${(100 * length) / data.width_mm}%`;
      ruler.style.maxWidth = this.stage.style.maxWidth;
      this.output = html("dl", { class: "facts", "aria-live": "polite" });
      this.where = html("p", { class: "note" });
      const note = data.step > 1 ? `One pixel of every ${data.step} × ${data.step} is here. ` : "";
      this.root.querySelector(".map").append(
        html("label", { class: "choice" }, "Shown", select), this.stage, ruler,
        html("div", { class: "scale" }, this.low, this.bar, this.high),
        html("p", { class: "note" }, `${note}Click to hold a pixel, and again to let it go.`),
      );
      this.root.querySelector(".at").append(this.output, this.where);
      const place = (event) => {
        const box = this.canvas.getBoundingClientRect();
        const inside = (t, n) => Math.min(n - 1, Math.max(0, Math.floor(t * n)));
        this.to(inside((event.clientY - box.top) / box.height, data.rows), inside((event.clientX - box.left) / box.width, data.cols));
      };
      this.stage.addEventListener("pointermove", (event) => this.held || place(event));
      this.stage.addEventListener("click", (event) => { this.held = !this.held; place(event); });
      this.stage.addEventListener("keydown", (event) => this.key(event));
    }

    key(event) {
      const step = { ArrowLeft: [0, -1], ArrowRight: [0, 1], ArrowUp: [-1, 0], ArrowDown: [1, 0] }[event.key];
      if (!step) return;
      event.preventDefault();
      const [row, col] = this.at;
      this.to(Math.min(this.data.rows - 1, Math.max(0, row + step[0])), Math.min(this.data.cols - 1, Math.max(0, col + step[1])));
    }

    // --- the map ---------------------------------------------------------------------------------------------------
    choose(k) {
      const { data } = this, layer = this.shown[k], context = this.canvas.getContext("2d");
      const picture = context.createImageData(data.cols, data.rows);
      const rgb = (hex, at) => [0, 2, 4].map((b) => parseInt(hex.substr(at + b, 2), 16));
      const unknown = rgb(data.unknown, 1), kinds = data.kinds.colours.map((c) => rgb(c, 1));
      const palette = layer.values ? Array.from({ length: 64 }, (_, j) => rgb(data.palettes[layer.palette], 6 * j)) : null;
      for (let j = 0; j < data.rows * data.cols; j++) {
        let colour = unknown;
        if (!palette) colour = kinds[this.kinds[j]];
        else if (layer.values[j] === layer.values[j]) {
          const place = layer.high > layer.low ? (layer.values[j] - layer.low) / (layer.high - layer.low) : 0;
          colour = palette[Math.min(63, Math.max(0, Math.round(63 * place)))];
        }
        picture.data.set([...colour, 255], 4 * j);
      }
      context.putImageData(picture, 0, 0);
      this.bar.replaceChildren();
      this.bar.className = palette ? "bar" : "bar kinds";
      this.bar.style.background = palette ? `linear-gradient(to right, ${palette.map((c) => `rgb(${c})`).join(",")})` : "none";
      this.low.textContent = palette ? digits(layer.low, 3) : "";
      this.high.textContent = palette ? digits(layer.high, 3) : "";
      if (!palette) {
        data.kinds.names.forEach((name, j) => {
          const box = html("i");
          box.style.background = data.kinds.colours[j];
          this.bar.append(html("span", {}, box, name));
        });
      }
    }

    // --- a pixel ---------------------------------------------------------------------------------------------------
    to(row, col) {
      const { data } = this, k = row * data.cols + col;
      this.at = [row, col];
      Object.assign(this.spot.style, { left: `${(100 * (col + 0.5)) / data.cols}%`, top: `${(100 * (row + 0.5)) / data.rows}%` });
      const rows = [["place", this.place(row, col)]];
      for (const l of this.layers) {
        const value = l.values[k], u = l.us ? l.us[k] : NaN;
        const words = Number.isNaN(value) ? "not determined" : l.fitted && Number.isNaN(u) ? `${digits(value, 4)}, at its bound` : value === 0 ? "0" : withU(value, u, 4);
        rows.push([l.label, words]);
      }
      rows.push(["flag", data.kinds.names[this.kinds[k]]]);
      this.output.replaceChildren(...rows.flatMap(([name, value]) => [html("dt", {}, name), html("dd", {}, value)]));
      this.curves(row, col);
    }

    place(row, col) {
      return `x = ${digits(this.data.x[col], 4)} mm, y = ${digits(this.data.y[row], 4)} mm`;
    }

    /** The model of a pixel, and what was measured there, as curves of the interactive plot. */
    curves(row, col) {
      const { data, measured, drawn } = this, model = MODELS[data.model] || drawn, some = measured || drawn;
      let where = "", cell = 0;
      if (some) { // the nearest pixel whose values are here
        const near = (t, n) => Math.min(n - 1, Math.max(0, Math.round((t - some.first) / some.stride)));
        const [r, c] = [near(row, some.rows), near(col, some.cols)];
        const old = [row, col];
        [row, col] = [some.first + r * some.stride, some.first + c * some.stride];
        where = row !== old[0] || col !== old[1] ? `The plot: ${this.place(row, col)}, the nearest pixel with ${measured ? "measured values" : "curves"} here.` : "";
        if (measured) this.spots = this.values(r, c, data.x[col], data.y[row]);
        cell = r * some.cols + c;
      }
      const k = row * data.cols + col, p = { k: 0, ...data.fixed };
      for (const l of this.layers) p[l.name] = l.values[k];
      const whole = model && this.layers.every((l) => l.name === "misfit" || !Number.isNaN(l.values[k]));
      if (!data.model) where += "";
      else if (!whole) where += " The model is not determined here.";
      this.where.textContent = where.trim();
      const incidences = measured ? measured.incidences : data.incidences;
      const points = measured ? ["measured"] : [], models = model ? [data.model] : [];
      const curves = incidences.map((nominal, j) => {
        const spots = measured ? this.spots.filter((s) => s.curve === j) : [];
        const ti = spots.length ? spots.reduce((sum, s) => sum + s.incidence, 0) / spots.length : nominal * RAD;
        const series = [];
        if (measured) series.push(series_of("measured", spots.map((s) => [s.angle, s.brdf, s.u]), ti, false));
        const curve = () => drawn
          ? drawn.angles.map((a, n) => [a * RAD, drawn.values[(cell * incidences.length + j) * drawn.angles.length + n], null])
          : angles(ti).map((a) => [a, model(p, ti, a), null]);
        if (model) series.push(series_of(data.model, whole ? curve() : [], ti, true));
        const own = series.find((s) => s.name === data.model);
        for (const s of series) s.by.model = own && own.by.mirror;
        return { label: `θi = ${degrees(Math.round(nominal * 10) / 10)}`, mirror: ti / RAD, series };
      });
      const labels = curves.map((c) => c.label);
      this.plot.show({ name: "pixel", moving: "θr", at: 0, labels, shown: labels, points, models, chosen: [...points, ...models],
        normalise: model ? "model" : "max", note: "", waves: [{ nm: null, curves }] });
    }

    /** Measured values of a pixel, in its own directions. */
    values(r, c, x, y) {
      const m = this.measured, first = (r * m.cols + c) * m.curve.length, out = [];
      m.curve.forEach((curve, j) => {
        const brdf = m.values[first + j], code = m.us[first + j];
        if (Number.isNaN(brdf)) return;
        const across = [-Math.cos(m.phi[j]), -Math.sin(m.phi[j])];
        const signed = (p) => Math.atan2((p[0] - x) * across[0] + (p[1] - y) * across[1], p[2]);
        const u = code ? brdf * m.fine ** (1 - (code - 1) / 254) : null;
        out.push({ curve, brdf, u, incidence: -signed(m.source[j]), angle: signed(m.camera[j]) });
      });
      return out.sort((a, b) => a.angle - b.angle);
    }
  }

  function series_of(name, points, mirror, theory) {
    const best = points.reduce((a, b) => (a && Math.abs(a[0] - mirror) <= Math.abs(b[0] - mirror) ? a : b), null);
    const near = best && Math.abs(best[0] - mirror) < 1.5 * RAD ? best[1] : null;
    return {
      name, angle: points.map((p) => p[0] / RAD), brdf: points.map((p) => p[1]), u: theory ? null : points.map((p) => p[2]),
      by: { mirror: near, max: points.length ? Math.max(...points.map((p) => p[1])) : null },
    };
  }
  /** Angles of a model's curve: degree by degree, and closer about the mirror direction. */
  function angles(mirror) {
    const out = [];
    for (let a = -85; a <= 85; a++) out.push(a * RAD);
    for (let a = -8; a <= 8; a += 0.25) if (Math.abs(mirror / RAD + a) < 85) out.push(mirror + a * RAD);
    return out.sort((a, b) => a - b);
  }

  for (const root of document.querySelectorAll(".pixels")) {
    new Pixels(root, JSON.parse(document.getElementById(`${root.id}-data`).textContent));
  }
})();
