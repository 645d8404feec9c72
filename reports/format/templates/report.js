"use strict";
(() => {
  const { palette, plots } = JSON.parse(document.getElementById("plots").textContent);
  const dark = matchMedia("screen and (prefers-color-scheme: dark)");
  const narrow = matchMedia("(max-width: 640px)");
  let printing = false;

  // Put the reader's colours in place of role:NAME, in a copy.
  const coloured = (value, scheme) => {
    if (typeof value === "string") return value.startsWith("role:") ? palette[value.slice(5)][scheme] : value;
    if (Array.isArray(value)) return value.map((item) => coloured(item, scheme));
    if (value && typeof value === "object")
      return Object.fromEntries(Object.entries(value).map(([key, item]) => [key, coloured(item, scheme)]));
    return value;
  };

  const axis = (own, scheme) => ({
    gridcolor: palette.grid[scheme], linecolor: palette.muted[scheme], tickcolor: palette.muted[scheme],
    showline: true, ticks: "outside", ticklen: 4, exponentformat: "none", ...own,
  });

  const draw = (name) => {
    const scheme = dark.matches && !printing ? 1 : 0;
    const plot = plots[name];
    const place = document.getElementById("plot-" + name);
    const layout = coloured(narrow.matches && !printing ? plot.narrow : plot.layout, scheme);
    for (const key of Object.keys(layout))
      if (/^[xy]axis/.test(key)) layout[key] = axis(layout[key], scheme);
    if (layout.scene)
      for (const key of ["xaxis", "yaxis", "zaxis"])
        layout.scene[key] = { ...layout.scene[key], gridcolor: palette.grid[scheme],
          zerolinecolor: palette.grid[scheme], backgroundcolor: palette.paper[scheme] };
    Object.assign(layout, {
      paper_bgcolor: palette.paper[scheme], plot_bgcolor: palette.paper[scheme],
      font: { family: "system-ui, sans-serif", size: 12, color: palette.ink[scheme] },
      legend: { orientation: "h", x: 0, xanchor: "left", y: 1, yref: "container", yanchor: "top" },
      dragmode: narrow.matches ? false : "zoom",
      uirevision: "kept",
    });
    const paper = document.body.clientWidth;
    if (plot.width < 1 && !narrow.matches) place.style.maxWidth = Math.max(420, 900 * plot.width) + "px";
    layout.width = printing ? Math.min(place.clientWidth || paper, 680) : undefined;
    layout.autosize = !printing;
    Plotly.react(place, coloured(plot.data, scheme), layout,
      { responsive: true, displaylogo: false, displayModeBar: printing ? false : undefined });
  };

  const drawAll = () => Object.keys(plots).forEach(draw);
  dark.addEventListener("change", drawAll);
  narrow.addEventListener("change", drawAll);
  addEventListener("beforeprint", () => { printing = true; drawAll(); });
  addEventListener("afterprint", () => { printing = false; drawAll(); });
  document.querySelectorAll(".plot noscript").forEach((note) => note.remove());
  drawAll();

  // The appendix opens where a link leads into it, and on paper; a plot in it is drawn when seen.
  const appendix = document.getElementById("appendix");
  if (appendix) {
    const reveal = () => {
      const target = location.hash && document.getElementById(location.hash.slice(1));
      if (target && appendix.contains(target) && !appendix.open) { appendix.open = true; target.scrollIntoView(); }
    };
    appendix.addEventListener("toggle", drawAll);
    addEventListener("hashchange", reveal);
    addEventListener("beforeprint", () => { appendix.open = true; });
    reveal();
  }
})();
