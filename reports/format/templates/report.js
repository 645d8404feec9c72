"use strict";
(() => {
  const { palette, plots } = JSON.parse(document.getElementById("plots").textContent);
  const names = Object.keys(plots);
  const dark = matchMedia("screen and (prefers-color-scheme: dark)");
  const narrow = matchMedia("(max-width: 640px)");
  const PRINTED_PX = 680; // width of a line on paper, at 96 px per inch
  const place = (name) => document.getElementById("plot-" + name);
  const drawn = new Set();
  let printing = false;

  // Put the reader's colours in place of role:NAME or role:DAY|NIGHT, in a copy.
  const coloured = (value, scheme) => {
    if (typeof value === "string") {
      if (!value.startsWith("role:")) return value;
      const [day, night = day] = value.slice(5).split("|");
      return palette[scheme ? night : day][scheme];
    }
    if (Array.isArray(value)) return value.map((item) => coloured(item, scheme));
    if (value && typeof value === "object")
      return Object.fromEntries(Object.entries(value).map(([key, item]) => [key, coloured(item, scheme)]));
    return value;
  };

  const axis = (own, scheme) => ({
    gridcolor: palette.grid[scheme], linecolor: palette.muted[scheme], tickcolor: palette.muted[scheme],
    showline: true, ticks: "outside", ticklen: 4, exponentformat: "none", ...own,
  });

  // A plot in a folded part is drawn when that unfolds.
  const draw = (name) => {
    if (place(name).closest("details:not([open])")) return;
    const scheme = dark.matches && !printing ? 1 : 0;
    const plot = plots[name];
    const layout = coloured(printing ? plot.printed : narrow.matches ? plot.narrow : plot.layout, scheme);
    for (const key of Object.keys(layout))
      if (/^[xy]axis/.test(key)) layout[key] = axis(layout[key], scheme);
    if (layout.scene)
      for (const key of ["xaxis", "yaxis", "zaxis"])
        layout.scene[key] = { ...layout.scene[key], gridcolor: palette.grid[scheme],
          zerolinecolor: palette.grid[scheme], backgroundcolor: palette.paper[scheme] };
    Object.assign(layout, {
      paper_bgcolor: palette.paper[scheme], plot_bgcolor: palette.paper[scheme],
      font: { family: "system-ui, sans-serif", size: printing ? 10 : 12, color: palette.ink[scheme] },
      legend: { orientation: "h", x: 0, xanchor: "left", y: 1, yref: "container", yanchor: "top" },
      dragmode: narrow.matches ? false : "zoom",
      uirevision: "kept",
    });
    if (plot.width < 1 && !narrow.matches) place(name).style.maxWidth = Math.max(420, 900 * plot.width) + "px";
    layout.width = printing ? PRINTED_PX * Math.max(plot.width, 0.6) : undefined;
    layout.autosize = !printing;
    Plotly.react(place(name), coloured(plot.data, scheme), layout,
      { responsive: true, displaylogo: false, displayModeBar: printing ? false : undefined });
    if (!drawn.has(name)) follow(name);
    drawn.add(name);
  };
  const drawAll = () => names.forEach(draw);

  // Charts over the same time show the same stretch of it.
  let following = false;
  const follow = (name) => place(name).on("plotly_relayout", (change) => {
    const key = Object.keys(change).find((key) => /^xaxis\d*\.(range(\[0\])?|autorange)$/.test(key));
    if (following || !key || !plots[name].time) return;
    const own = key.split(".")[0];
    const ends = change[own + ".range"] ?? [change[own + ".range[0]"], change[own + ".range[1]"]];
    const stretch = key.endsWith("autorange") ? { "xaxis.autorange": true } : { "xaxis.range": ends };
    following = true;
    const others = [...drawn].filter((other) => other !== name && plots[other].time === plots[name].time);
    Promise.all(others.map((other) => Plotly.relayout(place(other), stretch))).finally(() => { following = false; });
  });

  const start = () => {
    drawAll();
    dark.addEventListener("change", drawAll);
    narrow.addEventListener("change", drawAll);
    addEventListener("beforeprint", () => { printing = true; drawAll(); });
    addEventListener("afterprint", () => { printing = false; drawAll(); });
    appendix?.addEventListener("toggle", () => names.filter((name) => appendix.contains(place(name))).forEach(draw));
    document.documentElement.dataset.drawn = "";
  };

  // The appendix opens where a link leads into it, and on paper.
  const appendix = document.getElementById("appendix");
  const reveal = () => {
    const target = document.getElementById(location.hash.slice(1));
    const folded = target?.closest("details");
    if (folded && !folded.open) { folded.open = true; target.scrollIntoView(); }
  };
  addEventListener("hashchange", reveal);
  addEventListener("beforeprint", () => { if (appendix) appendix.open = true; });
  reveal();

  // The library travels deflated; a browser that cannot inflate it is told where the plots are.
  const inflate = async () => {
    if (window.Plotly) return; // a template of the user's own brings it along
    const packed = Uint8Array.from(atob(document.getElementById("library").textContent), (c) => c.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
    const script = document.createElement("script");
    script.textContent = await new Response(stream).text();
    document.head.append(script);
  };
  inflate().then(() => {
    document.querySelectorAll(".plot noscript").forEach((note) => note.remove());
    start();
  }, () => document.querySelectorAll(".plot noscript").forEach((note) => note.replaceWith(note.textContent)));
})();
