"use strict";
// Tables that sort by a click on a heading and keep the rows that hold what was typed.
(() => {
  const words = document.currentScript.dataset;
  const style = document.createElement("style");
  style.textContent = `
    thead button { all: unset; cursor: pointer; font: inherit; }
    thead button:focus-visible { outline: 2px solid var(--measured); outline-offset: 2px; }
    th[aria-sort=ascending] button::after { content: " ▲"; }
    th[aria-sort=descending] button::after { content: " ▼"; }
    .filter { display: flex; flex-wrap: wrap; gap: 0.75rem; align-items: baseline; margin: 0 0 0.5rem; font-size: 0.875rem; }
    .filter input { font: inherit; padding: 0.2rem 0.5rem; min-width: 14rem; color: inherit; background: transparent; border: 1px solid var(--muted); border-radius: 3px; }
    .filter output { color: var(--muted); }
    @media print { .filter { display: none; } th button::after { content: none !important; } }
  `;
  document.head.append(style);

  // "+0.312 ± 0.016" and "1 024" sort by their first number, other words as words, dashes last.
  const key = (text) => {
    const plain = text.trim().replace(/\u2212/g, "-").replace(/(\d)\u202f(?=\d{3})/g, "$1");
    if (plain === "–" || plain === "") return [2, 0, ""];
    const number = /^[+-]?\d+(\.\d+)?(?=$|[^\w.-])/.exec(plain);
    return number && !/^\d{4}-\d\d/.test(plain) ? [0, parseFloat(number[0]), plain] : [1, 0, plain];
  };
  const order = (a, b, up) => {
    if ((a[0] === 2) !== (b[0] === 2)) return a[0] - b[0];
    const by = a[0] - b[0] || a[1] - b[1] || a[2].localeCompare(b[2], undefined, { numeric: true });
    return up ? by : -by;
  };

  const sortable = (table) => {
    const heads = [...table.tHead.rows[0].cells];
    heads.forEach((head, column) => {
      const button = document.createElement("button");
      button.type = "button";
      button.append(...head.childNodes);
      head.append(button);
      button.addEventListener("click", () => {
        const up = head.getAttribute("aria-sort") !== "ascending";
        heads.forEach((other) => other.removeAttribute("aria-sort"));
        head.setAttribute("aria-sort", up ? "ascending" : "descending");
        const rows = [...table.tBodies[0].rows].map((row) => [key(row.cells[column].textContent), row]);
        rows.sort((a, b) => order(a[0], b[0], up));
        table.tBodies[0].append(...rows.map(([, row]) => row));
      });
    });
  };

  const filterable = (table, before) => {
    const rows = [...table.tBodies[0].rows];
    if (rows.length < 6) return;
    const box = document.createElement("div");
    const label = document.createElement("label");
    const input = document.createElement("input");
    const said = document.createElement("output");
    box.className = "filter";
    input.type = "search";
    input.placeholder = words.hint;
    label.append(`${words.filter}: `, input);
    box.append(label, said);
    before.before(box);
    input.addEventListener("input", () => {
      const asked = input.value.toLowerCase().split(/\s+/).filter(Boolean);
      let shown = 0;
      for (const row of rows) {
        const text = [...row.cells].map((cell) => cell.textContent.toLowerCase()).join(" ");
        row.hidden = !asked.every((word) => text.includes(word));
        shown += !row.hidden;
      }
      said.textContent = asked.length ? `${shown} ${words.of} ${rows.length} ${words.rows}` : "";
    });
  };

  document.querySelectorAll(".table table").forEach((table) => {
    sortable(table);
    filterable(table, table.closest(".scroll"));
  });
})();
