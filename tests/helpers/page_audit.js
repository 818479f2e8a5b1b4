// Finds controls without a name, ids that occur twice, and the contrast of each text with the colour behind it (WCAG).
() => {
  const named = (e) => e.getAttribute("aria-label") || [...(e.labels || [])].some((label) => label.textContent.trim())
    || (e.tagName === "BUTTON" && e.textContent.trim());
  const ids = [...document.querySelectorAll("[id]")].map((e) => e.id);
  const linear = (x) => (x <= 0.04045 ? x / 12.92 : ((x + 0.055) / 1.055) ** 2.4);
  const luminance = (colour) => {
    const [r, g, b] = colour.match(/[\d.]+/g).map((x) => linear(Number(x) / 255));
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const behind = (e) => {
    for (; e; e = e.parentElement) {
      const colour = getComputedStyle(e).backgroundColor;
      if (!/, 0\)$/.test(colour)) return colour;
    }
    return "rgb(255, 255, 255)";
  };
  const hasText = (e) => [...e.childNodes].some((node) => node.nodeType === 3 && node.data.trim());
  const contrast = (e) => {
    const [light, dark] = [luminance(getComputedStyle(e).color), luminance(behind(e))].sort((a, b) => b - a);
    return [e.textContent.trim().slice(0, 40), (light + 0.05) / (dark + 0.05)];
  };
  return {
    nameless: [...document.querySelectorAll("input, select, textarea, button, canvas")].filter((e) => !named(e)).map((e) => e.outerHTML),
    repeated: ids.filter((id, i) => ids.indexOf(id) !== i),
    contrasts: [...document.querySelectorAll("body *")].filter((e) => e.checkVisibility() && !e.disabled && hasText(e)).map(contrast),
  };
}
