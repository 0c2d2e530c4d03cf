// Draws the page's charts in place of its pictures. The page holds Plotly compressed; where a browser cannot
// decompress it, or runs no scripts, the pictures stay.
(async () => {
  const figures = [...document.querySelectorAll("figure.charts")];
  if (!window.DecompressionStream || !figures.length) return;
  const packed = Uint8Array.from(atob(document.getElementById("plotly").textContent), (c) => c.charCodeAt(0));
  const unpacked = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  const library = document.createElement("script");
  library.textContent = await new Response(unpacked).text();
  document.head.append(library);

  const probe = document.head.appendChild(document.createElement("span"));
  function resolved(value) {
    if (typeof value === "string" && value.startsWith("var(")) {
      probe.style.color = value;
      return getComputedStyle(probe).color;
    }
    if (Array.isArray(value)) return value.map(resolved);
    if (value && typeof value === "object")
      return Object.fromEntries(Object.entries(value).map(([name, inner]) => [name, resolved(inner)]));
    return value;
  }

  function element(name, parent, className, text = "") {
    const made = parent.appendChild(document.createElement(name));
    made.className = className;
    made.textContent = text;
    return made;
  }

  const touch = matchMedia("(pointer: coarse)").matches;
  const buttons = [["zoom2d", "pan2d", "zoomIn2d", "zoomOut2d", "resetScale2d"], ["toImage"]];
  const config = { responsive: true, displaylogo: false, modeBarButtons: buttons };
  const drawn = [];
  async function draw({ place, chart, hidden, small }) {
    const layout = resolved(chart.layout);
    layout.font = { ...layout.font, family: getComputedStyle(document.body).fontFamily };
    // A finger that moves over a chart scrolls the page; two fingers zoom the page.
    if (touch) layout.dragmode = false;
    const traces = resolved(chart.traces).map((trace) => (hidden.has(trace.name) ? { ...trace, visible: false } : trace));
    await Plotly.react(place, traces, layout, { ...config, displayModeBar: small || touch ? false : "hover" });
  }

  // One legend for charts side by side: it shows and hides a model in all of them.
  function addLegend(holder, members) {
    const legend = element("div", holder, "legend");
    holder.before(legend);
    const named = members.flatMap(({ chart }) => chart.traces.filter((trace) => trace.name && trace.line));
    for (const trace of new Map(named.map((trace) => [trace.name, trace])).values()) {
      const button = element("button", legend, "", trace.name);
      button.style.setProperty("--line", trace.line.color);
      button.setAttribute("aria-pressed", "true");
      button.onclick = () => {
        const shown = button.getAttribute("aria-pressed") !== "true";
        button.setAttribute("aria-pressed", shown);
        for (const member of members) {
          member.hidden[shown ? "delete" : "add"](trace.name);
          draw(member);
        }
      };
    }
  }

  for (const figure of figures) {
    const charts = JSON.parse(figure.querySelector("script").textContent);
    const holder = document.createElement("div");
    figure.querySelector("img").replaceWith(holder);
    holder.className = charts.length > 1 ? "panels" : "";
    const members = charts.map((chart) => {
      const panel = element("div", holder, "panel");
      if (chart.title) element("p", panel, "title", chart.title);
      const place = element("div", panel, "chart");
      place.style.height = `${chart.height}px`;
      return { place, chart, hidden: new Set(), small: charts.length > 1 };
    });
    if (charts.length > 1) addLegend(holder, members);
    for (const member of members) await draw(member);
    drawn.push(...members);
  }
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => drawn.forEach(draw));
  document.documentElement.dataset.drawn = drawn.length;
})();
