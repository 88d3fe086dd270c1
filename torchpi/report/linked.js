/* Draws the traces of the page's "linked-data": panels with one time axis, one zoom, one pointer. */
(function () {
  "use strict";
  const dark = window.matchMedia("(prefers-color-scheme: dark)");
  const HEIGHT = 400, AXIS = 34, LEFT = 66, PHONE = 600;

  const number = (value, digits) =>
    value == null ? "–" : value.toLocaleString("en", { maximumSignificantDigits: digits }).replace("-", "−");

  /* Colours are those of white paper, which the page's style inverts where it is dark, but for a few. */
  function color(hex) {
    const name = "--" + hex.slice(1).toLowerCase();
    return getComputedStyle(document.documentElement).getPropertyValue(name).trim() || hex;
  }

  function drawn(data, into, key) {
    const plots = [];
    const total = data.panels.reduce((sum, panel) => sum + panel.share, 0);
    const width = () => Math.max(into.clientWidth, 200);
    data.panels.forEach((panel, place) => {
      const last = place === data.panels.length - 1;
      const ink = "#1a1a1a", grid = { stroke: "#e2e2e2", width: 1 };
      const axis = { stroke: ink, grid: grid, ticks: grid, font: "12px system-ui, sans-serif", labelFont: "12px system-ui, sans-serif" };
      const options = {
        width: width(),
        height: Math.round((HEIGHT * panel.share) / total) + (last ? AXIS : 0),
        scales: { x: { time: false } },
        padding: [6, 22, last ? 0 : 8, 0],
        cursor: { sync: { key: key }, drag: { x: true, y: false }, points: { size: 6 } },
        axes: [
          Object.assign({}, axis, { show: last, size: AXIS, values: (_, at) => at.map((s) => number(s, 6) + " s") }),
          Object.assign({}, axis, { size: LEFT, label: panel.label + " (" + panel.unit + ")", labelSize: 18, values: (_, at) => at.map((v) => number(v, 5)) }),
        ],
        series: [{ label: "t", value: (_, value) => number(value, 7) + (value == null ? "" : " s") }].concat(
          panel.curves.map((curve) => ({
            label: curve.label,
            show: curve.shown,
            stroke: color(curve.color),
            width: curve.width,
            dash: curve.dash,
            points: { show: false },
            value: (_, value) => number(value, 4) + (value == null ? "" : " " + panel.unit),
          }))
        ),
        hooks: {
          drawClear: [
            (plot) => {
              plot.ctx.save();
              plot.ctx.fillStyle = "rgba(0,0,0,.06)";
              plot.ctx.beginPath();
              plot.ctx.rect(plot.bbox.left, plot.bbox.top, plot.bbox.width, plot.bbox.height);
              plot.ctx.clip();
              for (const [from, to] of data.shaded) {
                const left = plot.valToPos(from, "x", true);
                plot.ctx.fillRect(left, plot.bbox.top, plot.valToPos(to, "x", true) - left, plot.bbox.height);
              }
              plot.ctx.restore();
            },
          ],
        },
      };
      plots.push(new uPlot(options, [data.t].concat(panel.curves.map((curve) => curve.values)), into));
    });
    plots.forEach((plot) => plot.setScale("x", { min: data.view[0], max: data.view[1] }));
    const watch = new ResizeObserver(() => {
      for (const plot of plots) if (plot.width !== width()) plot.setSize({ width: width(), height: plot.height });
    });
    watch.observe(into);
    return { plots: plots, end: () => { watch.disconnect(); plots.forEach((plot) => plot.destroy()); } };
  }

  function button(text, says, into, acts) {
    const made = document.createElement("button");
    made.type = "button";
    made.textContent = text;
    made.setAttribute("aria-label", says);
    made.addEventListener("click", acts);
    into.appendChild(made);
  }

  document.querySelectorAll("script.linked-data").forEach((source, place) => {
    const data = JSON.parse(source.textContent);
    const live = document.createElement("div");
    live.className = "live";
    source.before(live);
    source.parentElement.classList.add("drawn");
    const title = document.createElement("b");
    title.textContent = data.title;
    live.appendChild(title);
    const panels = document.createElement("div");
    live.appendChild(panels);
    let now = drawn(data, panels, "linked-" + place);
    dark.addEventListener("change", () => { now.end(); now = drawn(data, panels, "linked-" + place); });

    const first = data.t[0], end = data.t[data.t.length - 1];
    function scaled(by) {
      const x = now.plots[0].scales.x, middle = (x.min + x.max) / 2, half = (by * (x.max - x.min)) / 2;
      const range = { min: Math.max(first, middle - half), max: Math.min(end, middle + half) };
      now.plots.forEach((plot) => plot.setScale("x", range));
    }
    const bar = document.createElement("p");
    bar.className = "bar quiet";
    button("+", "zoom in", bar, () => scaled(0.5));
    button("−", "zoom out", bar, () => scaled(2));
    button("whole", "the whole record", bar, () => scaled(Infinity));
    const note = document.createElement("span");
    note.textContent = data.note;
    bar.appendChild(note);
    live.appendChild(bar);
  });
})();
