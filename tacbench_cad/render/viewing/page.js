"use strict";
// Draws the parts with k3d, and adds the deviation from the formula at each pixel, filled cuts, and sizes.
(() => {
  const byId = (id) => document.getElementById(id);
  const scene = JSON.parse(byId("description").textContent);
  const things = scene.things;
  const blocks = things.filter((thing) => thing.kind === "block");
  const state = { view: "", block: 0, colour: "part", cut: "", at: 0.5, flip: false, apart: 0, jig: false, sizes: true, press: false, look: "corner" };
  const { HEIGHTS, DEVIATIONS, uniforms, dress } = colours, MODES = { part: 0, height: 1, deviation: 2 };
  const FORCES = ["#007a5a", "#c04f00", "#0b5a8a"];
  const COMPLAINT = "This browser cannot draw the parts (it needs WebGL 2). The panel lists the sizes.";
  let K3D = null, world = null;

  function bytes(id) {
    const text = atob(byId(id).textContent);
    byId(id).textContent = "";
    return Uint8Array.from(text, (letter) => letter.charCodeAt(0));
  }

  const inflated = (id) => new Response(new Blob([bytes(id)]).stream().pipeThrough(new DecompressionStream("deflate")));

  // Restores a mesh from its packed form: the differences down each column, as 32-bit integers, sorted by byte.
  function restored(packed, start, [vertices, triangles]) {
    const count = 3 * (vertices + triangles), numbers = new Int32Array(3 * vertices), corners = new Uint32Array(3 * triangles);
    let at = start;
    for (const [into, rows] of [[numbers, vertices], [corners, triangles]]) {
      for (let column = 0; column < 3; column += 1) {
        let value = 0;
        for (let row = 0; row < rows; row += 1, at += 1) {
          value = (value + (packed[at] | (packed[at + count] << 8) | (packed[at + 2 * count] << 16) | (packed[at + 3 * count] << 24))) | 0;
          into[3 * row + column] = value;
        }
      }
    }
    return {
      vertices: { data: new Float32Array(numbers.buffer), shape: [vertices, 3] },
      indices: { data: corners, shape: [triangles, 3] },
    };
  }
  async function fill() {
    const packed = new Uint8Array(await inflated("meshes").arrayBuffer());
    let start = 0;
    for (const thing of things) {
      const tables = restored(packed, start, thing.counts), json = world.ObjectsListJson[thing.id];
      await K3D.reload(Object.assign(json, tables), tables);
      start += 12 * (thing.counts[0] + thing.counts[1]);
    }
  }

  // Shows another mesh of a block; the design page calls it after each change.
  async function replace(block, tables, { low, high, range, line }) {
    const resized = String([block.low, block.high]) !== String([low, high]);
    Object.assign(block, { low, high });
    block.formula.range = range;
    uniforms.tbLine.value = line;
    await K3D.reload(Object.assign(world.ObjectsListJson[block.id], tables), tables);
    dress(block, K3D.getObjectById(block.id));
    if (resized) await K3D.rebuildSceneData();  // the camera sees as far as the new size needs
    change({}, resized ? state.look : "");
  }

  async function library() {
    const source = await inflated("library").text();
    // The library expects an AMD loader. For a single module this is enough.
    return await new Promise((resolve) => {
      const define = (name, needs, make) => resolve(make());
      define.amd = true;
      new Function("define", source)(define);
    });
  }

  // ---- points and matrices (by columns) ----
  const turn = (m, p) => [0, 1, 2].map((i) => m[i] * p[0] + m[4 + i] * p[1] + m[8 + i] * p[2]);
  const place = (m, p) => turn(m, p).map((value, i) => value + m[12 + i]);
  const ONE = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];
  const lifted = (m, dz) => m.map((value, i) => (i === 14 ? value + dz : value));
  const corners = (low, high) => Array.from({ length: 8 }, (_, i) => [0, 1, 2].map((k) => ((i >> k) & 1 ? high : low)[k]));
  function boxOf(points) {
    const of = (choose) => [0, 1, 2].map((i) => choose(...points.map((p) => p[i])));
    return { low: of(Math.min), high: of(Math.max) };
  }
  function project(p) {
    const camera = world.camera, size = byId("canvas").getBoundingClientRect();
    const seen = place(camera.matrixWorldInverse.elements, p), m = camera.projectionMatrix.elements;
    const [x, y, , w] = [0, 1, 2, 3].map((i) => m[i] * seen[0] + m[4 + i] * seen[1] + m[8 + i] * seen[2] + m[12 + i]);
    return [(x / w / 2 + 0.5) * size.width, (0.5 - y / w / 2) * size.height];
  }

  // ---- what is visible, and where ----
  const theBlock = () => blocks[state.block];
  function shown() {
    const block = theBlock();
    if (state.view === "texture" || state.view === "block") return [block];
    const set = block && block.set !== null ? block.set : 0;
    if (state.view !== "assembly") return things.filter((thing) => thing.kind === state.view && (thing.set === null || thing.set === set)).slice(0, 1);
    // The other pockets of a tray are filled too, each with the first block whose place it is.
    const slots = new Map(block ? [[block.slot, block]] : []);
    for (const thing of blocks) if (thing.set === set && !slots.has(thing.slot)) slots.set(thing.slot, thing);
    const laid = new Set(slots.values());
    return things.filter((thing) => laid.has(thing) || (thing.kind !== "block" && thing.set === set && !hidden(thing)));
  }
  // The jig would cover the textures of the blocks: it is visible if the user asks for it, or if there is no block.
  const hidden = (thing) => thing.kind === "jig" && blocks.length > 0 && !state.jig;
  function lift(thing) {
    if (state.view !== "assembly" || thing.kind === "holder") return 0;
    const block = theBlock(), tall = block ? block.high[2] : 8;
    return state.apart * (thing.kind === "block" ? tall + 4 : 2.2 * tall + 8);
  }
  const matrixOf = (thing) => lifted(thing.matrix, lift(thing));
  // Sizes and cuts are in the frame of the block if it is visible, else in the frame of the holder.
  function frame() {
    const block = shown().includes(theBlock()) ? theBlock() : null;
    return block ? matrixOf(block) : ONE;
  }
  const back = (m, p) => { const q = [p[0] - m[12], p[1] - m[13], p[2] - m[14]]; return [0, 1, 2].map((i) => m[4 * i] * q[0] + m[4 * i + 1] * q[1] + m[4 * i + 2] * q[2]); };
  const pointsOf = (thing) => corners(thing.low, thing.high).map((p) => place(matrixOf(thing), p));
  const boxIn = (m) => boxOf(shown().flatMap(pointsOf).map((p) => back(m, p)));

  // ---- what the state means for the picture ----
  function apply() {
    const seen = new Set(shown());
    uniforms.tbMode.value = MODES[state.colour];
    uniforms.tbOnly.value = theBlock() ? theBlock().id : 0;
    if (theBlock()) uniforms.tbRange.value = theBlock().formula.range;  // the scale is this block's own
    for (const thing of things) {
      for (const [id, visible] of [[thing.id, seen.has(thing)], [thing.press && thing.press.id, seen.has(thing) && state.press]]) {
        const object = id ? K3D.getObjectById(id) : null;
        if (!object) continue;
        object.visible = visible;
        object.position.z = thing.matrix[14] + lift(thing);
        object.updateMatrix();
        object.updateMatrixWorld(true);
      }
    }
    section();
    paint();
    drawPanel();
  }
  // k3d finishes a picture after it has returned, and two pictures at once would mix: start at most one in each frame.
  let painting = 0;
  function paint() {
    cancelAnimationFrame(painting);
    painting = requestAnimationFrame(() => K3D.render());
  }
  function section() {
    const axis = "xyz".indexOf(state.cut), row = byId("cut-row");
    row.hidden = !state.cut;
    const planes = K3D.parameters.clippingPlanes;
    planes.length = 0;
    if (!state.cut) return;
    const m = frame(), box = boxIn(m), at = box.low[axis] + state.at * (box.high[axis] - box.low[axis]);
    const way = [0, 0, 0];
    // The face of the cut is turned towards the corner from which the page is first seen.
    way[axis] = (axis < 2) === state.flip ? -1 : 1;
    const normal = turn(m, way), through = [0, 0, 0];
    through[axis] = at;
    const p = place(m, through);
    planes.push([...normal, -(normal[0] * p[0] + normal[1] * p[1] + normal[2] * p[2])]);
    byId("cut-value").textContent = `${state.cut} = ${at.toFixed(2)} mm`;
  }

  // ---- camera ----
  const LOOKS = { corner: [-0.62, -1.1, 0.85], front: [0, -1, 0.001], right: [1, 0, 0.001], top: [0, -0.001, 1], below: [0, -0.001, -1] };
  function look(name) {
    state.look = name;
    const points = shown().flatMap(pointsOf), box = boxOf(points);
    const size = byId("canvas").getBoundingClientRect(), steep = Math.tan((world.camera.fov * Math.PI) / 360);
    const [dx, dy, dz] = LOOKS[name].map((part) => part / Math.hypot(...LOOKS[name])), flat = Math.hypot(dx, dy);
    const right = [-dy / flat, dx / flat, 0], up = [(-dx * dz) / flat, (-dy * dz) / flat, flat];
    let middle = [0, 1, 2].map((i) => (box.low[i] + box.high[i]) / 2), far = 0;
    for (let round = 0; round < 4; round += 1) {
      const seen = points.map((point) => [right, up, [dx, dy, dz]].map((way) => way.reduce((sum, part, i) => sum + part * (point[i] - middle[i]), 0)));
      // The smallest distance at which all corners of the parts are visible, with room for the sizes around them.
      far = Math.max(...seen.map(([x, y, z]) => z + (1.2 / steep) * Math.max(Math.abs(y), (Math.abs(x) * size.height) / size.width)));
      // Near parts look larger, so the middle of the picture is not quite the middle of the box.
      const { low, high } = boxOf(seen.map(([x, y, z]) => [x / (far - z), y / (far - z), 0]));
      middle = middle.map((value, i) => value + (far / 2) * (right[i] * (low[0] + high[0]) + up[i] * (low[1] + high[1])));
    }
    K3D.setCamera([middle[0] + dx * far, middle[1] + dy * far, middle[2] + dz * far, ...middle, 0, 0, 1]);
    paint();
  }
  // Turns the camera about the middle of the picture, by angles in radians, and moves it nearer by a factor.
  function orbit(around, up, nearer) {
    const [x, y, z] = world.camera.position.toArray(), [tx, ty, tz] = world.controls.target.toArray(), far = Math.hypot(x - tx, y - ty, z - tz);
    const a = Math.atan2(y - ty, x - tx) + around, e = Math.min(1.57, Math.max(-1.57, Math.asin((z - tz) / far) + up)), flat = (far / nearer) * Math.cos(e);
    K3D.setCamera([tx + flat * Math.cos(a), ty + flat * Math.sin(a), tz + (far / nearer) * Math.sin(e), tx, ty, tz, 0, 0, 1]);
    paint();
  }
  const KEYS = { ArrowLeft: [-0.1, 0, 1], ArrowRight: [0.1, 0, 1], ArrowUp: [0, 0.1, 1], ArrowDown: [0, -0.1, 1], "+": [0, 0, 1.15], "=": [0, 0, 1.15], "-": [0, 0, 1 / 1.15] };
  function turned(event) {
    if (!KEYS[event.key] || event.ctrlKey || event.metaKey || event.altKey || event.target.closest("input, select")) return;
    event.preventDefault();
    orbit(...KEYS[event.key]);
  }

  // ---- sizes and contacts, drawn over the picture ----
  function draw() {
    const sheet = byId("over"), size = sheet.getBoundingClientRect(), dense = window.devicePixelRatio || 1;
    sheet.width = Math.round(size.width * dense);
    sheet.height = Math.round(size.height * dense);
    const pen = sheet.getContext("2d");
    pen.scale(dense, dense);
    pen.font = "600 13px system-ui, 'DejaVu Sans', sans-serif";
    if (state.press) contacts(pen);
    if (state.sizes) sizes(pen, size);
  }
  function label(pen, text, [x, y], colour, size) {
    const wide = pen.measureText(text).width + 8;
    if (size) { x = Math.min(Math.max(x, wide / 2 + 2), size.width - wide / 2 - 2); y = Math.min(Math.max(y, 12), size.height - 12); }
    pen.fillStyle = "#ffffffdd";
    pen.fillRect(x - wide / 2, y - 9, wide, 18);
    pen.fillStyle = colour;
    pen.textAlign = "center";
    pen.textBaseline = "middle";
    pen.fillText(text, x, y);
  }
  function sizes(pen, size) {
    const m = frame(), box = boxIn(m), gap = 0.05 * Math.max(...[0, 1, 2].map((i) => box.high[i] - box.low[i]));
    const eye = back(m, world.camera.position.toArray());
    const near = [0, 1, 2].map((i) => (eye[i] < (box.low[i] + box.high[i]) / 2 ? -1 : 1));
    const end = (i, side, out = 0) => (side < 0 ? box.low[i] - out : box.high[i] + out);
    const z = end(2, near[2] < 0 ? 1 : -1);
    const upright = Math.abs(eye[0] - end(0, near[0])) > Math.abs(eye[1] - end(1, near[1])) ? [end(0, near[0]), end(1, -near[1], gap)] : [end(0, -near[0], gap), end(1, near[1])];
    const lines = [
      [[box.low[0], end(1, near[1], gap), z], [box.high[0], end(1, near[1], gap), z]],
      [[end(0, near[0], gap), box.low[1], z], [end(0, near[0], gap), box.high[1], z]],
      [[...upright, box.low[2]], [...upright, box.high[2]]],
    ];
    lines.forEach(([from, to], axis) => {
      if (axis === 2 && state.view === "assembly" && state.apart > 0) return;  // the distance between parts is not a size of any part
      const [a, b] = [from, to].map((p) => project(place(m, p)));
      const long = Math.hypot(b[0] - a[0], b[1] - a[1]);
      if (long < 14) return;
      const along = [(b[0] - a[0]) / long, (b[1] - a[1]) / long];
      pen.strokeStyle = "#1c2126";
      pen.lineWidth = 1.2;
      pen.beginPath();
      pen.moveTo(...a);
      pen.lineTo(...b);
      for (const [tip, way] of [[a, 1], [b, -1]]) {
        for (const side of [1, -1]) {
          pen.moveTo(...tip);
          pen.lineTo(tip[0] + way * 9 * along[0] - side * 3.5 * along[1], tip[1] + way * 9 * along[1] + side * 3.5 * along[0]);
        }
      }
      pen.stroke();
      const text = `${"xyz"[axis]} ${Number((box.high[axis] - box.low[axis]).toFixed(3))} mm`;
      label(pen, text, [(a[0] + b[0]) / 2, (a[1] + b[1]) / 2], "#1c2126", size);
    });
  }
  function contacts(pen) {
    const block = theBlock();
    if (!block || !block.press || !shown().includes(block)) return;
    const m = matrixOf(block), at = block.press.positions, middle = at[(at.length - 1) / 2];
    block.press.contacts.forEach(([, radius], i) => {
      pen.strokeStyle = FORCES[i];
      pen.lineWidth = 2;
      pen.beginPath();
      for (let k = 0; k <= 96; k += 1) {
        const a = (2 * Math.PI * k) / 96;
        const p = project(place(m, [middle[0] + radius * Math.cos(a), middle[1] + radius * Math.sin(a), block.high[2]]));
        if (k) pen.lineTo(...p); else pen.moveTo(...p);
      }
      pen.stroke();
    });
    const centre = project(place(m, middle));
    for (const i of [0, 4, 20, 24]) {
      const p = project(place(m, at[i])), away = Math.hypot(p[0] - centre[0], p[1] - centre[1]) || 1;
      label(pen, String(i + 1), [p[0] + (14 * (p[0] - centre[0])) / away, p[1] + (14 * (p[1] - centre[1])) / away], "#1c2126");
    }
  }

  // ---- the panel ----
  function element(tag, text, into) {
    const node = into.appendChild(document.createElement(tag));
    if (text !== undefined) node.textContent = text;
    return node;
  }
  function drawPanel() {
    const seen = shown(), block = seen.includes(theBlock()) ? theBlock() : undefined;
    for (const button of byId("views").children) button.setAttribute("aria-pressed", button.value === state.view);
    byId("apart-row").hidden = state.view !== "assembly";
    byId("texture-row").hidden = blocks.length < 2 || !["texture", "block", "assembly"].includes(state.view);
    byId("jig-label").hidden = state.view !== "assembly" || !block || !things.some((thing) => thing.kind === "jig" && thing.set === block.set);
    byId("press-label").hidden = !(block && block.press);
    for (const id of ["colour", "cut", "apart"]) byId(id).value = state[id];
    for (const id of ["sizes", "jig", "press"]) byId(id).checked = state[id];
    byId("texture").value = state.block;
    byId("cut-at").value = state.at;
    byId("flip").hidden = !state.cut;
    drawScale(block);
    const legend = byId("legend");
    legend.replaceChildren();
    const pressed = block && block.press ? block : null;
    if (state.press && pressed) {
      element("p", `${pressed.press.positions.length} positions, numbered row by row from low y. The circles show the contact on a flat plate at the middle position:`, legend);
      pressed.press.contacts.forEach(([force, radius], i) => {
        const line = element("p", undefined, legend), mark = element("i", undefined, line);
        mark.style.borderColor = FORCES[i];
        line.append(`${force.toFixed(2)} N: radius ${radius.toFixed(1)} mm`);
      });
    }
    const facts = byId("facts");
    facts.replaceChildren();
    for (const thing of seen.filter((other) => other.kind !== "block" || other === block)) {
      const head = element("h2", undefined, facts), mark = element("i", undefined, head);
      mark.style.background = thing.colour;
      head.append(thing.name);
      const list = element("dl", undefined, facts);
      for (const [name, value] of thing.facts) { element("dt", name, list); element("dd", value, list); }
    }
  }
  function drawScale(block) {
    const exact = block && block.formula.waves !== null;  // the shader calculates deviations from waves only
    byId("colour").options[2].disabled = block && !exact;
    const scale = byId("scale"), mode = block && (exact || state.colour !== "deviation") ? state.colour : "part";
    scale.hidden = mode === "part";
    if (scale.hidden) return;
    const deviating = mode === "deviation", formula = block.formula, bound = 1000 * formula.scale;
    scale.querySelector("figcaption").textContent = deviating ? "distance of the mesh from the formula (µm)" : "height z (mm)";
    scale.querySelector(".bar").style.background = `linear-gradient(to right, ${(deviating ? DEVIATIONS : HEIGHTS).join(", ")})`;
    const ends = deviating ? [-bound, bound] : formula.range, ticks = scale.querySelector(".ticks");
    ticks.replaceChildren();
    for (let i = 0; i <= 4; i += 1) {
      const value = ends[0] + ((ends[1] - ends[0]) * i) / 4;
      element("span", (deviating && value > 1e-9 ? "+" : "") + (Math.abs(value) < 1e-9 ? "0" : Number(value.toPrecision(3))), ticks);
    }
  }
  function change(changes, newLook) {
    Object.assign(state, changes);
    apply();
    if (newLook) look(newLook);
  }
  function goTo(view) {
    const texture = view === "texture";
    change({ view, colour: texture ? "height" : state.colour === "height" ? "part" : state.colour }, texture ? "top" : "corner");
  }
  function fillPanel() {
    const views = [...(blocks.length ? ["texture"] : []), ...new Set(things.map((thing) => thing.kind))];
    if (new Set(things.filter((thing) => thing.set !== null).map((thing) => thing.kind)).size > 1) views.push("assembly");
    for (const view of views) {
      const button = element("button", view[0].toUpperCase() + view.slice(1), byId("views"));
      button.value = view;
      button.onclick = () => goTo(view);
    }
    blocks.forEach((thing, i) => { element("option", thing.name, byId("texture")).value = i; });
    for (const name of Object.keys(LOOKS)) element("button", name, byId("looks")).onclick = () => look(name);
    for (const id of ["colour", "cut"]) byId(id).onchange = (event) => change({ [id]: event.target.value });
    for (const [id, name] of [["texture", "block"], ["cut-at", "at"], ["apart", "apart"]]) {
      byId(id).oninput = (event) => change({ [name]: Number(event.target.value) });
    }
    for (const id of ["sizes", "press"]) byId(id).onchange = (event) => change({ [id]: event.target.checked });
    byId("jig").onchange = (event) => {
      const jig = event.target.checked;
      change({ jig, apart: jig ? Math.max(state.apart, 0.55) : 0 }, state.look);
    };
    byId("flip").onclick = () => change({ flip: !state.flip });
    document.onkeydown = turned;
    byId("version").textContent = scene.version;
    byId("left-out").textContent = scene.left_out.map((item) => `left out: ${item.what}: ${item.reason}`).join("; ");
    state.view = views.includes("assembly") ? "assembly" : views.includes("block") ? "block" : views[0];
  }

  async function start() {
    document.body.classList.toggle("framed", window.parent !== window);
    fillPanel();
    drawPanel();
    try {
      if (!document.createElement("canvas").getContext("webgl2")) throw new Error("no WebGL 2");
      const lib = await library();
      K3D = await lib.CreateK3DAndLoadBinarySnapshot(bytes("objects"), byId("canvas"));
      world = K3D.getWorld();
      await fill();
    } catch (error) {
      byId("wait").textContent = COMPLAINT;
      document.body.dataset.failed = String(error);
      throw error;
    }
    for (const thing of things) dress(thing, K3D.getObjectById(thing.id));
    K3D.on(K3D.events.RENDERED, draw);
    change({}, "corner");
    new ResizeObserver(() => { K3D.resizeHelper(); look(state.look); }).observe(byId("stage"));
    requestAnimationFrame(() => requestAnimationFrame(() => {
      byId("wait").remove();
      document.body.dataset.ready = Math.round(performance.now());
    }));
    // For scripts and tests: the same switches as the panel's, and where a point of the world is on the page.
    window.tacbench = { state, things, change, goTo, look, project, matrixOf, replace, K3D };
    document.dispatchEvent(new Event("shown"));
  }
  start();
})();
