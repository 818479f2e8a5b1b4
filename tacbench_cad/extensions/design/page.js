"use strict";
// The controls of the design page. The server calculates; this file sends the state and shows the answers.
(() => {
  const byId = (id) => document.getElementById(id);
  const MAX_TEXT = 500000, MAX_IMAGE = 60000000, PAUSE_MS = 300;
  let design, shown = 0, last = null, groups = [];
  let busy = false, changed = 0, pause = 0, state = 0, sliders = 0;
  const STOPPED = "The server has stopped. Start the command again to continue.", ALIVE_MS = 2000;

  const say = (text) => { byId("status").textContent = text; };
  function complain(text) {
    byId("error").hidden = !text;
    if (byId("error").textContent !== (text || "")) byId("error").textContent = text || "";
  }

  // ---- the connection ----
  async function ask(question, address = "ask") {
    const body = question instanceof File ? question : JSON.stringify(question);
    const answer = await fetch(address, { method: "POST", body }).catch(() => { throw new Error(STOPPED); });
    if (!answer.headers.get("content-type")) return answer.arrayBuffer();
    const result = answer.ok ? await answer.json() : { error: await answer.text() };
    if (result.error) throw new Error(result.error);
    return result;
  }

  async function tried(work) {
    try { await work(); } catch (error) { complain(error.message); }
  }

  // ---- pictures ----
  // One picture is under way at a time. Changes in the meantime are sent together when it has arrived.
  function update() {
    changed ||= performance.now();
    state += 1;
    clearTimeout(pause);
    if (!busy) next();
  }

  async function next() {
    const since = changed;
    busy = true;
    changed = 0;
    try {
      last = unpack(await ask({ do: "picture", design }));
      complain("");
      await draw();
      requestAnimationFrame(() => {
        document.body.dataset.ready ??= performance.now();
        document.body.dataset.pictures = 1 + Number(document.body.dataset.pictures || 0);
        document.body.dataset.ms = performance.now() - since;
      });
    } catch (error) { complain(error.message); }
    busy = false;
    if (changed) next();
    else pause = setTimeout(results, PAUSE_MS);
  }

  function unpack(data) {
    const length = new DataView(data).getUint32(0, true), header = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
    const count = header.lines[0] * header.lines[1], { points } = header;
    let at = 4 + length;
    const take = (size) => { const part = new Float32Array(data, at, size); at += 4 * size; return part; };
    return { ...header, tops: [take(count), take(count)], cuts: [take(points), take(points)], cut: cutLine(header.size) };
  }

  function cutLine(size) {
    const across = design.cut === "x" ? 1 : 0;
    return [across === 0 ? 1 : 0, across, design.cut_at * size[across]];
  }

  async function draw() {
    if (!last) return;
    byId("equation").textContent = `z = ${last.equation}`;
    drawCut();
    const view = byId("block").contentWindow.tacbench;  // the 3D page, when it is ready
    if (!view) return;
    const { size, range, cut } = last, [block] = view.things;
    if (view.state.colour !== "height") view.change({ colour: "height" });
    await view.replace(block, meshOf(last.tops[shown], last.lines, size), { low: [0, 0, 0], high: [...size, range[1]], range, line: cut });
  }

  // The triangles of the top between the lines of the grid, of the walls and of the underside. The height is 0 outside
  // of the outline.
  function meshOf(heights, [n, m], size) {
    const { Float32Array, Uint32Array } = byId("block").contentWindow;  // three.js knows only the types of its own window
    const vertices = new Float32Array(6 * n * m), corners = [], low = n * m;
    heights.forEach((z, i) => {
      const [x, y] = [(size[0] * (i % n)) / (n - 1), (size[1] * Math.floor(i / n)) / (m - 1)];
      vertices.set([x, y, z], 3 * i);
      vertices.set([x, y, 0], 3 * (low + i));
    });
    const quad = (a, b, c, d) => corners.push(a, b, c, a, c, d), whole = heights.every((z) => z > 0);
    const inside = (...at) => at.some((i) => heights[i] > 0);
    for (let j = 0; j < m - 1; j += 1) {
      for (let i = 0; i < n - 1; i += 1) {
        const a = j * n + i, b = a + 1, c = b + n, d = a + n;
        if (!inside(a, b, c, d)) continue;
        quad(a, b, c, d);
        if (!whole) quad(low + a, low + d, low + c, low + b);
      }
      for (const [a, b] of [[(j + 1) * n, j * n], [j * n + n - 1, (j + 2) * n - 1]]) if (inside(a, b)) quad(a, low + a, low + b, b);
    }
    for (let i = 0; i < n - 1; i += 1) {
      for (const [a, b] of [[i, i + 1], [m * n - 1 - i, m * n - 2 - i]]) if (inside(a, b)) quad(a, low + a, low + b, b);
    }
    if (whole) quad(low, low + (m - 1) * n, low + m * n - 1, low + n - 1);
    return { vertices: { data: vertices, shape: [2 * n * m, 3] }, indices: { data: Uint32Array.from(corners), shape: [corners.length / 3, 3] } };
  }

  function drawCut() {
    const canvas = byId("cut"), box = canvas.getBoundingClientRect(), dense = devicePixelRatio;
    Object.assign(canvas, { width: Math.round(box.width * dense), height: Math.round(box.height * dense) });
    const pen = canvas.getContext("2d", { willReadFrequently: true }), along = last.cut[1] ? 0 : 1, length = last.size[along], tall = last.range[1];
    pen.scale(dense, dense);
    // The scale is the same in both directions, so that the slopes are true.
    const scale = Math.min((box.width - 20) / length, (box.height - 30) / tall), left = (box.width - scale * length) / 2, ground = box.height - 20;
    const trace = (heights) => heights.forEach((z, i) => pen.lineTo(left + (scale * length * i) / (heights.length - 1), ground - scale * z));
    pen.beginPath();
    pen.moveTo(left, ground);
    trace(last.cuts[1]);
    pen.lineTo(left + scale * length, ground);
    pen.fillStyle = "#dfe4e8";
    pen.fill();
    for (const [heights, colour] of [[last.cuts[1], "#b04a00"], [last.cuts[0], "#0b5a8a"]]) {
      pen.beginPath();
      trace(heights);
      pen.lineWidth = 1.6;
      pen.strokeStyle = colour;
      pen.stroke();
    }
    pen.fillStyle = "#1c2126";
    pen.font = "12px system-ui, sans-serif";
    pen.textBaseline = "top";
    pen.fillText("0", left, ground + 4);
    pen.textAlign = "right";
    pen.fillText(`${length.toFixed(1)} mm`, left + scale * length, ground + 4);
    const worst = last.cuts[0].reduce((most, z, i) => Math.max(most, Math.abs(z - last.cuts[1][i])), 0);
    const words = `Cut along ${along ? "y" : "x"} at ${along ? "x" : "y"} = ${last.cut[2].toFixed(2)} mm. Largest difference of the heights: ${worst.toFixed(3)} mm.`;
    byId("cut-words").textContent = words;
    canvas.setAttribute("aria-label", words);
  }

  // ---- results, when the user pauses ----
  async function results() {
    const asked = state;
    say("Calculating…");
    try {
      const file = await ask({ do: "toml", design });
      if (asked !== state) return;
      byId("toml").value = file.toml;
      const { facts } = await ask({ do: "facts", design });
      if (asked !== state) return;
      byId("facts").replaceChildren(...facts.flatMap(([name, value]) => [element("dt", name), element("dd", value)]));
      const known = Object.fromEntries(facts);
      byId("block").setAttribute("title", `The block in 3D: ${facts.slice(0, 3).map((fact) => fact.join(" ")).join(", ")}`);
      say(`Relief ${known.relief}, ${known.triangles} triangles, ${facts[4][0]}: ${facts[4][1]}.`);
    } catch (error) {
      if (asked !== state) return;
      byId("facts").replaceChildren();
      complain(error.message);
      say("This block cannot be made.");
    }
  }

  // ---- controls ----
  function element(name, text = "", attributes = {}) {
    const made = Object.assign(document.createElement(name), attributes);
    if (text) made.textContent = text;
    return made;
  }

  function setAt(path, value) {
    const [key] = path.slice(-1), table = path.slice(0, -1).reduce((inner, step) => inner[step], design), old = table[key];
    table[key] = value;
    if (key === "mm_per_pixel" && old > 0 && value > 0) {  // the block keeps its part of the height map
      design.size_mm = design.size_mm.map((side) => Number((side * value / old).toFixed(6)));
      for (const i of [0, 1]) {
        const slider = document.querySelector(`[data-path="size_mm.${i}"]`);
        slider.max = Math.max(slider.max, design.size_mm[i]);
        slider.value = slider.nextSibling.value = design.size_mm[i];
      }
    }
    update();
  }

  function row(control) {
    const { path, label, words, low, high, step, value } = control, id = `control-${(sliders += 1)}`, made = element("div", "", { className: "row" });
    made.append(element("label", label, { htmlFor: id }));
    if (words) {
      const select = element("select", "", { id });
      select.append(...words.map((word) => element("option", word)));
      select.value = value;
      select.addEventListener("change", () => setAt(path, select.value));
      made.append(select);
      return made;
    }
    const whole = Number.isInteger(step), shownValue = (x) => String(Number(x.toPrecision(6)));
    const slider = element("input", "", { id, type: "range", min: low, max: high, step: whole ? step : "any" });
    const field = element("input", "", { type: "number", step: whole ? step : "any", value: shownValue(value) });
    slider.value = value;
    slider.dataset.path = path.join(".");
    field.setAttribute("aria-label", `${label}, number`);
    slider.addEventListener("input", () => {
      // A slider moves in steps from its lowest value, but a value that was typed or read stays as it is.
      const x = whole ? Number(slider.value) : Number((Math.round((Number(slider.value) - low) / step) * step + low).toFixed(6));
      field.value = shownValue(x);
      setAt(path, x);
    });
    slider.addEventListener("keydown", (event) => {
      const by = { ArrowLeft: -1, ArrowDown: -1, ArrowRight: 1, ArrowUp: 1, PageDown: -10, PageUp: 10 }[event.key];
      if (whole || !by) return;
      event.preventDefault();
      slider.value = Math.min(high, Math.max(low, Number(slider.value) + by * step));
      slider.dispatchEvent(new Event("input"));
    });
    field.addEventListener("input", () => {
      if (field.value === "" || !Number.isFinite(field.valueAsNumber)) return;
      slider.value = field.valueAsNumber;
      setAt(path, field.valueAsNumber);
    });
    made.append(slider, field);
    return made;
  }

  function take(answer) {
    const kept = design && { nozzle_mm: design.nozzle_mm, cut: design.cut, cut_at: design.cut_at };
    design = { ...answer.design, ...kept };
    groups = answer.groups;
    byId("name").value = design.name;
    byId("groups").replaceChildren(...groups.map((group) => {
      const made = element("fieldset");
      made.append(element("legend", group.title), ...group.rows.map(row));
      return made;
    }));
    byId("wave-buttons").hidden = design.texture.family !== "plane-waves";
    byId("fewer").disabled = design.wave.length < 2;
    update();
  }

  const written = (name, ok) => element("li", `${name}${ok ? "" : " (not written)"}`);
  async function write() {
    const formats = [...document.querySelectorAll("#formats input:checked")].map((box) => box.value);
    if (!formats.length) throw new Error("Choose at least one file format.");
    byId("write").disabled = true;
    say("Writing the files…");
    try {
      const { files, failed } = await ask({ do: "write", design, formats });
      complain("");
      byId("files").replaceChildren(...files.map((name) => written(name, true)), ...failed.map((name) => written(name, false)));
      say(failed.length ? `${failed.length} files failed their checks.` : `Wrote ${files.length} files, all of them checked.`);
    } catch (error) {
      say("The files were not written.");
      throw error;
    } finally { byId("write").disabled = false; }
  }

  async function copy() {
    const { toml, name } = await ask({ do: "toml", design });
    byId("toml").value = toml;
    try { await navigator.clipboard.writeText(toml); say(`Copied. Save the text as ${name}.`); } catch {
      byId("toml").closest("details").open = true;
      byId("toml").select();
      say("The browser did not allow copying. The text is selected: press Ctrl+C.");
    }
  }

  async function openFile(file) {
    if (!file) return;
    const isText = /\.toml$/i.test(file.name), most = isText ? MAX_TEXT : MAX_IMAGE;
    if (file.size > most) throw new Error(`${file.name} is too large: it has ${(file.size / 1e6).toFixed(1)} MB, and ${most / 1e6} MB are allowed.`);
    say(`Reading ${file.name}…`);
    try {
      take(isText ? await ask({ do: "open", text: await file.text(), name: file.name }) : await ask(file, `upload?name=${encodeURIComponent(file.name)}`));
      byId("start").value = "";
    } catch (error) {
      say("The file was not opened.");
      throw error;
    }
  }

  function listen() {
    byId("start").addEventListener("change", () => tried(async () => take(await ask({ do: "start", text: byId("start").value }))));
    byId("open").addEventListener("change", () => tried(() => openFile(byId("open").files[0])));
    for (const name of ["dragover", "dragleave", "drop"]) {
      document.addEventListener(name, (event) => {
        event.preventDefault();
        document.body.classList.toggle("over", name === "dragover");
        if (name === "drop") tried(() => openFile(event.dataTransfer.files[0]));
      });
    }
    byId("name").addEventListener("input", () => setAt(["name"], byId("name").value));
    byId("cut-along").addEventListener("change", () => setAt(["cut"], byId("cut-along").value));
    for (const [id, by] of [["more", 1], ["fewer", -1]]) {
      byId(id).addEventListener("click", () => tried(async () => {
        take(await ask({ do: "waves", design, count: design.wave.length + by }));
        say(`${design.wave.length} waves.`);
      }));
    }
    for (const box of document.querySelectorAll("[name=shown]")) box.addEventListener("change", () => { shown = Number(box.value); draw(); });
    byId("write").addEventListener("click", () => tried(write));
    byId("copy").addEventListener("click", () => tried(copy));
    byId("controls").addEventListener("submit", (event) => event.preventDefault());
    new ResizeObserver(() => last && drawCut()).observe(byId("cut"));
  }

  async function begin() {
    const answer = await ask({ do: "hello" });
    byId("start").append(...answer.starts.map((name) => element("option", name)));
    byId("start").value = answer.start;
    byId("out").textContent = answer.out;
    for (const [name, missing] of Object.entries(answer.formats)) {
      const label = element("label"), box = element("input", "", { type: "checkbox", value: name, checked: !missing, disabled: Boolean(missing) });
      label.append(box, ` ${name.toUpperCase()}${missing ? ` (${missing})` : ""}`);
      byId("formats").append(label);
    }
    byId("fixed").append(...answer.fixed.map((control) => row(control)));
    take(answer);
  }

  const framed = () => { byId("block").contentDocument.addEventListener("shown", draw); draw(); };
  byId("block").addEventListener("load", framed);
  if (byId("block").contentDocument.readyState === "complete") framed();
  tried(async () => { listen(); await begin(); });
  setInterval(() => fetch("page.css", { method: "HEAD" }).catch(() => complain(STOPPED)), ALIVE_MS);
})();
