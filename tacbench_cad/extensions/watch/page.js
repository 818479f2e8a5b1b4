"use strict";
// The watch page. The server sends the contents whenever they change; this file shows them.
(() => {
  const byId = (id) => document.getElementById(id);
  const SVG = "http://www.w3.org/2000/svg", RETRY_MS = 2000, MARKER_LINE_PX = 30, WIDE = 400, HIGH = 260, LEFT = 44, RIGHT = 10, TOP = 12, BOTTOM = 34;
  const chosen = new URLSearchParams(location.search).get("run") || "";
  let socket, state = null, asked = "", refused = "";

  function say(id, text) {  // a text that did not change is not announced again
    if (byId(id).textContent !== text) byId(id).textContent = text;
  }
  function complain(text) {
    byId("error").hidden = !text;
    say("error", text || "");
  }
  function element(name, text = "", attributes = {}) {
    const made = Object.assign(document.createElement(name), attributes);
    if (text) made.textContent = text;
    return made;
  }
  function shape(name, attributes, text) {
    const made = document.createElementNS(SVG, name);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    if (text !== undefined) made.textContent = text;
    return made;
  }
  const presses = (count) => `${count} press${count === 1 ? "" : "es"}`;
  function duration(seconds) {
    const minutes = Math.floor(seconds / 60), two = (x) => String(x).padStart(2, "0");
    return `${Math.floor(minutes / 60)}:${two(minutes % 60)}:${two(seconds % 60)}`;
  }

  // ---- the connection ----
  function connect() {
    socket = new WebSocket(`${location.origin.replace("http", "ws")}${location.pathname}socket?run=${encodeURIComponent(chosen)}`);
    socket.onopen = () => complain("");
    socket.onmessage = ({ data }) => {
      const message = JSON.parse(data);
      if (message.error) { refused = message.error; complain(refused); return; }
      state = message;
      show();
      document.body.dataset.states = 1 + Number(document.body.dataset.states || 0);
    };
    socket.onclose = () => {
      const over = state && state.buttons && state.session && state.session.over;  // the server ends with the run
      if (over) { say("status", `${status()} The server of this page has ended.`); buttons(false); return; }
      complain("The page has lost its connection and tries again. A run that is under way goes on.");
      buttons(false);
      setTimeout(connect, RETRY_MS);
    };
  }
  function order(message) {
    refused = "";
    complain(state.fault);
    if (socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify(message));
  }
  function buttons(enabled) {
    for (const id of ["pause", "stop", "in"]) byId(id).disabled = !enabled;
  }

  // ---- the contents ----
  function status() {
    const { session, run, runs, under_way: underWay } = state;
    if (session && session.over) return `The session has ended (${session.over.outcome}): ${session.over.message}.`;
    if (session && session.killed) return "The session has ended without an outcome: its process was killed. The same command resumes it.";
    if (session && session.question) return "Put in the next block.";
    if (session && session.paused) return "Paused. The sensor is lifted after the press that is under way.";
    if (underWay && session && session.pressing) return `Pressing ${session.run}.`;
    if (underWay) return "The rig is being prepared.";
    if (!runs.length) return "There is no run yet.";
    return run && run.done < run.total ? "No run is under way; this run is not complete." : "No run is under way.";
  }

  function show() {
    const { session, run } = state, live = state.under_way;
    say("status", status());
    complain(refused || state.fault);
    byId("buttons").hidden = !(state.buttons && live);
    say("pause", session && session.paused ? "Continue" : "Pause");
    buttons(true);
    question(live ? session && session.question : null);
    counts();
    frames(run);
    force(run);
    map(run);
    findings(run, session);
    list("runs", state.runs.map(({ name, done, total }) => {
      const made = element("li"), current = run && run.name === name;
      made.append(element("a", name, { href: `?run=${encodeURIComponent(name)}` }), ` ${done} of ${presses(total)}`);
      if (current) made.firstChild.setAttribute("aria-current", "true");
      return made;
    }));
  }

  function list(id, items) {
    const text = items.map((item) => item.outerHTML).join("");
    if (byId(id).innerHTML !== text) byId(id).replaceChildren(...items);
  }

  function question(asks) {
    byId("question").hidden = !asks;
    if (!asks) { asked = ""; say("question-text", ""); return; }
    byId("confirm").hidden = !state.buttons;
    if (asked === asks.run) return;
    asked = asks.run;
    byId("typed").value = "";
    const where = asks.slot ? `slot ${asks.slot}` : "the holder";
    say("question-text", `Put the block with the label ${asks.label} into ${where} (${asks.run.replaceAll("_", ", ")}).${state.buttons ? " Read the label on its underside and type it." : " Confirm it where the run was started."}`);
    byId("label").toggleAttribute("hidden", !asks.picture);  // SVG elements have no property "hidden"
    if (asks.picture) {
      const [width, height] = asks.picture.size, [plate, glyphs] = byId("label").children;
      byId("label").setAttribute("viewBox", `-0.2 -0.2 ${width + 0.4} ${height + 0.4}`);
      byId("label").setAttribute("aria-label", `The underside of the block, with the label ${asks.label}`);
      plate.setAttribute("width", width);
      plate.setAttribute("height", height);
      glyphs.setAttribute("d", asks.picture.path);
    }
  }

  function counts() {
    const { session, run } = state, rows = [];
    if (run) {
      rows.push(["Run", run.name], ["Presses of this run", `${run.done} of ${run.total}`]);
      if (run.missed) rows.push(["Outside of their force band", presses(run.missed)]);
      if (run.press) rows.push(["This press", `number ${run.press.number}, position ${run.press.position}${run.press.target === null ? "" : `, target ${run.press.target} N`}`]);
    }
    if (session) {
      rows.push(["Presses of the study", `${session.saved} of ${session.planned}, ${session.blocks} block${session.blocks === 1 ? "" : "s"}`]);
      if (session.run_s !== null) rows.push(["Time left for this run", duration(session.run_s)], ["Time left for the study", duration(session.study_s)]);
      if (session.temperature_c !== null) rows.push(["Temperature of the room", `${session.temperature_c.toFixed(1)} °C`]);
      rows.push(["Last event", new Date(1000 * session.time).toLocaleString()]);
    }
    if (run && run.simulated.length) rows.push(["Simulated", run.simulated.map((device) => device.split(":")[0]).join(", ")]);
    byId("counts").replaceChildren(...rows.flatMap(([name, value]) => [element("dt", name), element("dd", value)]));
  }

  function frames(run) {
    for (const id of ["newest", "reference"]) {
      const frame = run && run[id], image = byId(id), isNew = id === "newest";
      image.hidden = !(frame && frame.image);
      if (!frame) say(`${id}-words`, isNew ? "No frame yet." : "No reference yet.");
      else say(`${id}-words`, `${isNew ? "Newest frame" : "Reference, without contact"}: ${frame.path}${frame.fault ? `, ${frame.fault}` : ""}`);
      if (frame && frame.image) {
        const address = `frame/${id}?run=${encodeURIComponent(run.name)}&path=${encodeURIComponent(frame.path)}`;
        if (image.getAttribute("src") !== address) Object.assign(image, { src: address, alt: byId(`${id}-words`).textContent });
      }
    }
    const series = run ? [run.reference, run.newest].map((frame) => frame && frame.values) : [];
    byId("values").toggleAttribute("hidden", !series.some(Boolean));
    if (series.some(Boolean)) values(series);
    const markers = run && run.newest && run.markers && run.markers.path === run.newest.path ? run.markers : null, drawn = markers && markers.lines.length > 0;
    if (drawn) {
      byId("markers").setAttribute("viewBox", `-0.5 -0.5 ${markers.size.join(" ")}`);
      const times = Math.min(10, Math.max(1, Math.floor(MARKER_LINE_PX / (markers.max_px || 1))));
      byId("markers").replaceChildren(shape("path", { d: markers.lines.map(([x, y, a, b]) => `M${x},${y}l${times * (a - x)},${times * (b - y)}`).join("") }));
      say("marker-words", `${markers.found} of ${markers.count} markers found. Displacement: median ${markers.median_px} px, largest ${markers.max_px} px. Each line begins at the ${markers.origin}${times > 1 ? ` and is ${times} times as long as the displacement` : ""}.`);
    } else if (!run || !run.newest || (run.markers && run.markers.path === run.newest.path)) {
      byId("markers").replaceChildren();
      say("marker-words", run && run.newest && run.newest.image ? "No markers were found in this frame." : "");
    } else byId("markers").replaceChildren();
  }

  function values(series) {
    const all = series.flatMap((numbers) => numbers || []), low = Math.min(...all), span = Math.max(...all) - low || 1;
    byId("values").setAttribute("viewBox", "0 0 400 120");
    byId("values").replaceChildren(...series.map((numbers, i) => shape("polyline", {
      class: i ? "now" : "old",
      points: (numbers || []).map((value, k) => `${(400 * k) / Math.max(1, numbers.length - 1)},${110 - (100 * (value - low)) / span}`).join(" "),
    })));
  }

  function force(run) {
    const old = run ? run.curves : [], now = run ? run.curve : [], points = run ? run.points : [], press = run && run.press;
    const all = [...old.flat(), ...now, ...points].filter(([, force]) => Number.isFinite(force));
    const svg = byId("force");
    if (!all.length) {
      svg.replaceChildren();
      say("force-words", run ? "No force was measured yet." : "");
      svg.setAttribute("aria-label", "No force was measured yet");
      return;
    }
    const touched = all.filter(([, force]) => force > 0.02), seen = touched.length ? touched : all;
    const from = Math.min(...seen.map(([depth]) => depth)) - 0.3, to = Math.max(...all.map(([depth]) => depth)) + 0.1;
    const top = 1.1 * Math.max(0.1, ...all.map(([, force]) => force), press && press.target ? press.target : 0);
    const x = (depth) => LEFT + ((depth - from) / (to - from)) * (WIDE - LEFT - RIGHT), y = (force) => HIGH - BOTTOM - (Math.max(force, 0) / top) * (HIGH - BOTTOM - TOP);
    const line = (curve, kind) => shape("polyline", { class: kind, points: curve.filter(([depth]) => depth >= from).map(([depth, force]) => `${x(depth).toFixed(1)},${y(force).toFixed(1)}`).join(" ") });
    const parts = [shape("path", { class: "axis", d: `M${LEFT},${TOP}V${HIGH - BOTTOM}H${WIDE - RIGHT}` })];
    for (const part of [0, 0.5, 1]) {
      parts.push(shape("text", { x: LEFT - 6, y: y(part * top) + 4, "text-anchor": "end" }, (part * top).toFixed(2)));
      const depth = from + part * (to - from);
      parts.push(shape("text", { x: x(depth), y: HIGH - BOTTOM + 16, "text-anchor": part === 1 ? "end" : part ? "middle" : "start" }, depth.toFixed(2)));
    }
    parts.push(shape("text", { x: WIDE - RIGHT, y: HIGH - 3, "text-anchor": "end" }, "depth below the highest point (mm)"), shape("text", { x: LEFT + 4, y: TOP }, "force (N)"));
    if (press && press.target) parts.push(shape("line", { class: "target", x1: LEFT, x2: WIDE - RIGHT, y1: y(press.target), y2: y(press.target) }));
    parts.push(...old.map((curve) => line(curve, "old")), ...points.map(([depth, force]) => shape("circle", { class: "point", cx: x(depth), cy: y(force), r: 2.5 })), line(now, "now"));
    svg.replaceChildren(...parts);
    const [last] = now.slice(-1), [end] = points.slice(-1);
    const words = last ? `This press: ${last[1].toFixed(3)} N at ${last[0].toFixed(3)} mm.` : end ? `Last press: ${end[1].toFixed(3)} N at ${end[0].toFixed(3)} mm.` : "";
    say("force-words", `${words} ${old.length ? "Thin lines: the last presses." : ""} Dots: the forces of the last ${points.length} presses.${press && press.target ? " Dashed: the target." : ""}`.trim());
    svg.setAttribute("aria-label", `Force against depth. ${words}`);
  }

  function map(run) {
    const places = run ? run.map : [], xs = [...new Set(places.map(({ x }) => x))].sort((a, b) => a - b), ys = [...new Set(places.map(({ y }) => y))].sort((a, b) => b - a);
    const rows = ys.map((y) => {
      const made = element("tr");
      made.append(...xs.map((x) => {
        const place = places.find((each) => each.x === x && each.y === y), cell = element("td");
        if (!place) return cell;
        const size = Math.abs(place.error), known = place.error !== null;
        cell.className = `${known ? (size <= 1 ? "in" : size <= 2 ? "near" : "far") : place.done ? "done" : ""}${place.now ? " current" : ""}`;
        cell.textContent = known ? `${place.error > 0 ? "+" : ""}${place.error.toFixed(1)}` : place.done || "";
        cell.title = `position ${place.position}: ${place.done} of ${presses(place.planned)}`;
        return cell;
      }));
      return made;
    });
    const body = byId("map").tBodies[0];
    byId("map").hidden = !places.length;
    body.replaceChildren(...rows);
    const hasForce = places.some(({ error }) => error !== null);
    say("map-words", !places.length ? "This run has no press grid." : hasForce
      ? "The largest error at each position, in half widths of the force band: up to 1 is in the band. Low y is at the bottom."
      : "The number of presses at each position. Low y is at the bottom.");
  }

  function findings(run, session) {
    const found = run && run.findings;
    say("findings-words", !run ? "" : found === null ? "The run is being checked." : found.length ? `${found.length} finding${found.length === 1 ? "" : "s"} in the frames and tables so far.` : "Nothing is wrong so far.");
    list("findings", (found || []).map(({ where, text }) => element("li", `${where} ${text}`)));
    list("messages", (session ? session.messages : []).map((text) => element("li", text)));
  }

  byId("stop").addEventListener("click", () => { order({ do: "stop" }); say("status", "Stopping…"); });
  byId("pause").addEventListener("click", () => order({ do: state.session && state.session.paused ? "continue" : "pause" }));
  byId("confirm").addEventListener("submit", (event) => { event.preventDefault(); order({ do: "in", label: byId("typed").value }); });
  connect();
})();
