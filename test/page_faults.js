// What a reader stumbles over in the page as it is laid out: text out of the window, cut off, or over other text.
const SLACK = 2.0;  // [px] below which nothing is seen
const MARK = 24.0;  // [px] up to which a shape is a mark; larger ones are areas
const SHARE = 0.3;  // of a line's height that two lines may have in common: accents, descenders
const told = [];
const short = text => text.trim().replace(/\s+/g, " ").slice(0, 40);
const page = document.documentElement, seen = page.clientWidth, whole = page.scrollWidth;
if (whole > seen + 0.5) told.push(`the page is ${whole} px wide in a window of ${seen}`);

// What scrolls sideways or is cut off; code and formulas may scroll, what is for screen readers alone is no fault.
const hides = style => style.overflowX !== "visible" || style.overflowY !== "visible";
for (const box of document.querySelectorAll("body *")) {
  if (box instanceof SVGElement || box.closest("pre, math, .formula, nav, .sidebar-drawer, .toc-drawer")) continue;
  if (box.clientWidth > 1 && box.scrollWidth > box.clientWidth + SLACK && getComputedStyle(box).overflowX !== "visible")
    told.push(`cut off or scrolled: ${box.tagName.toLowerCase()} ${short(box.textContent)}`);
}

// The visible part of every line of text, as [left, top, right, bottom, what, picture].
const clipped = (rect, element) => {
  if (!element.checkVisibility()) return null;  // within what is folded up
  let [left, top, right, bottom] = [rect.left, rect.top, rect.right, rect.bottom];
  for (let e = element; e && e !== document.body; e = e.parentElement) {
    const style = getComputedStyle(e);
    if (style.visibility === "hidden" || style.opacity === "0") return null;
    if (style.position === "fixed" && e.getBoundingClientRect().right <= 0) return null;
    if (e instanceof SVGElement || !hides(style)) continue;
    const frame = e.getBoundingClientRect();
    [left, top] = [Math.max(left, frame.left), Math.max(top, frame.top)];
    [right, bottom] = [Math.min(right, frame.right), Math.min(bottom, frame.bottom)];
  }
  return right - left > SLACK && bottom - top > SLACK ? [left, top, right, bottom] : null;
};
const lines = [];
const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
for (let node = walker.nextNode(); node; node = walker.nextNode()) {
  const parent = node.parentElement;
  if (!node.textContent.trim() || parent.closest("math, title, desc, script, style, noscript")) continue;
  const range = document.createRange();
  range.selectNodeContents(node);
  const rects = parent.closest("svg") ? [parent.getBoundingClientRect()] : range.getClientRects();
  for (const rect of rects) {
    const part = clipped(rect, parent);
    if (!part) continue;
    if (part[0] > seen) continue;  // a drawer that is shut; it would widen the page if it were none
    if (part[2] > seen + SLACK && !parent.closest("pre, .formula"))
      told.push(`out of the window: ${short(node.textContent)}`);
    lines.push([...part, short(node.textContent), parent.closest("svg")]);
  }
}
lines.sort((one, other) => one[1] - other[1]);
const common = (a, b, k) => Math.min(a[k + 2], b[k + 2]) - Math.max(a[k], b[k]);
lines.forEach((line, index) => {
  for (let next = index + 1; next < lines.length && lines[next][1] < line[3]; next++) {
    const other = lines[next], least = Math.min(line[3] - line[1], other[3] - other[1]);
    if (common(line, other, 0) > SLACK && common(line, other, 1) > SHARE * least)
      told.push(`one over the other: ${line[4]} | ${other[4]}`);
  }
});

// Marks of a picture over its letters, and letters out of their picture.
for (const picture of document.querySelectorAll("svg")) {
  const frame = picture.getBoundingClientRect(), own = lines.filter(line => line[5] === picture);
  for (const line of own)
    if (line[0] < frame.left - SLACK || line[2] > frame.right + SLACK) told.push(`out of its picture: ${line[4]}`);
  for (const mark of picture.querySelectorAll("use")) {
    const { left, top, right, bottom } = mark.getBoundingClientRect(), box = [left, top, right, bottom];
    if (right - left > MARK || bottom - top > MARK) continue;
    for (const line of own)
      if (common(box, line, 0) > SLACK && common(box, line, 1) > SLACK) told.push(`a mark over: ${line[4]}`);
  }
}
return [...new Set(told)];
