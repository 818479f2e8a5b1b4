"use strict";
// The colours of parts by pixel: heights, deviations from the formula, and the faces of cuts.
const colours = (() => {
  const DOWN = ["#0b4f8a", "#4f93c4", "#a9cce3"], UP = ["#f6c9a0", "#e2894a", "#a8430b"], ZERO = "#f4f4f2";
  const DEVIATIONS = [...DOWN, ZERO, ...UP];
  const HEIGHTS = ["#2b1d5b", "#2f5d8c", "#2f8f86", "#7cc04f", "#f6e65a"];
  const rgb = (hex) => [1, 3, 5].map((i) => parseInt(hex.slice(i, i + 2), 16) / 255);
  const real = (value) => { const text = String(Number(value)); return /[.e]/.test(text) ? text : `${text}.0`; };
  const ramp = (name, colours) => `vec3 ${name}(float t) { t = clamp(t, 0.0, 1.0) * ${real(colours.length - 1)};
    vec3 c = vec3(${rgb(colours[0]).map(real)});
    ${colours.slice(1).map((colour, i) => `c = mix(c, vec3(${rgb(colour).map(real)}), clamp(t - ${real(i)}, 0.0, 1.0));`).join("\n")}
    return c; }`;
  // What all materials share: the mode, the block that is coloured and its lowest and highest z, and a line across it:
  // the points with line.x * x + line.y * y = line.z.
  const uniforms = { tbMode: { value: 0 }, tbOnly: { value: 0 }, tbRange: { value: [0, 1] }, tbLine: { value: [0, 0, 1] } };

  function dress(thing, object) {
    const formula = thing.formula;
    const wave = ([a, f, g, p]) => `wave(${[a, f, g, p].map(real)}, q, z, slope);`;
    const top = formula ? `
      vec3 up = cross(dFdx(tbPlace), dFdy(tbPlace));
      if (tbOnly == ${thing.id} && abs(up.z) > 1e-4 * length(up) && tbPlace.z > tbRange.x - 0.5 && gl_FrontFacing && facesUp()) {
        if (tbMode == 1) gl_FragColor.rgb = heights((tbPlace.z - tbRange.x) / (tbRange.y - tbRange.x)) * light;
        ${formula.waves ? `if (tbMode == 2) { vec2 q = tbPlace.xy; float z = ${real(formula.datum)}; vec2 slope = vec2(0.0);
          ${formula.waves.map(wave).join("\n")}
          gl_FragColor.rgb = deviations(0.5 + 0.5 * (tbPlace.z - z) / sqrt(1.0 + dot(slope, slope)) / ${real(formula.scale)}); }` : ""}
        if (abs(dot(tbLine.xy, tbPlace.xy) - tbLine.z) < 0.08) gl_FragColor.rgb = vec3(0.69, 0.29, 0.0);
      }` : "";
    const head = `varying vec3 tbPlace; uniform int tbMode; uniform int tbOnly; uniform vec2 tbRange; uniform vec3 tbLine;
      ${ramp("heights", HEIGHTS)} ${ramp("deviations", DEVIATIONS)}
      void wave(float a, float f, float g, float p, vec2 q, inout float z, inout vec2 slope) {
        float t = f * q.x + g * q.y + p; t = 6.283185307179586 * (t - floor(t + 0.5));
        z += a * sin(t); slope += 6.283185307179586 * a * cos(t) * vec2(f, g); }
      // Whether the triangle under the pixel faces upwards: the top of a block is a height field.
      bool facesUp() { vec3 n = normalize(cross(dFdx(vViewPosition), dFdy(vViewPosition)));
        vec3 u = normalize((viewMatrix * vec4(0.0, 0.0, 1.0, 0.0)).xyz); if (dot(n, vViewPosition) < 0.0) n = -n; return dot(n, u) > 1e-4; }`;
    const cut = rgb(thing.colour).map((c) => real(0.78 * c));
    const tail = `
      float light = clamp(0.45 + 0.75 * dot(gl_FragColor.rgb, vec3(0.3333)), 0.6, 1.06);
      if (tbMode > 0) gl_FragColor.rgb = vec3(0.80, 0.81, 0.82) * light;
      ${top}
      // The inside of a closed part is visible only through a cut. Painted flat, it looks like the face of the cut.
      if (!gl_FrontFacing) { float stripe = mod(gl_FragCoord.x + gl_FragCoord.y, 9.0);
        gl_FragColor.rgb = vec3(${cut}) * (stripe < 1.6 ? 0.62 : 1.0);
        #ifdef USE_LOGARITHMIC_DEPTH_BUFFER
        gl_FragDepth = max(0.0, gl_FragDepth - 2e-4);  // parts that touch do not flicker
        #endif
      }`;
    object.traverse((part) => {
      if (!part.isMesh) return;
      const material = part.material;
      material.onBeforeCompile = (shader) => {
        Object.assign(shader.uniforms, uniforms);
        shader.vertexShader = "varying vec3 tbPlace;\n" + shader.vertexShader.replace("#include <begin_vertex>", "#include <begin_vertex>\n tbPlace = position;");
        shader.fragmentShader = shader.fragmentShader.replace("void main() {", `${head}\nvoid main() {`).replace("#include <dithering_fragment>", `${tail}\n#include <dithering_fragment>`);
      };
      material.customProgramCacheKey = () => `tacbench-${thing.id}`;
      material.needsUpdate = true;
    });
  }

  return { HEIGHTS, DEVIATIONS, uniforms, dress };
})();
