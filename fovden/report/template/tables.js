"use strict";
// Tables that sort by a click on a column's head, and copy themselves as CSV or LaTeX.

function valueOf(cell) {
  return cell.dataset.value !== undefined ? Number(cell.dataset.value) : cell.textContent;
}

// Sorts by a column; what is empty or not a number stands last either way.
function sortTable(table, column, descending) {
  const body = table.tBodies[0];
  const rows = [...body.rows];
  const missing = (value) => value === "" || Number.isNaN(value);
  rows.sort((first, second) => {
    const a = valueOf(first.cells[column]), b = valueOf(second.cells[column]);
    if (missing(a) || missing(b)) return missing(a) - missing(b);
    const order = typeof a === "number" && typeof b === "number" ? a - b : String(a).localeCompare(String(b));
    return descending ? -order : order;
  });
  body.append(...rows);
  [...table.tHead.rows[0].cells].forEach((head, index) => {
    if (index === column) head.setAttribute("aria-sort", descending ? "descending" : "ascending");
    else head.removeAttribute("aria-sort");
  });
}

function headings(table) {
  return [...table.tHead.rows[0].cells].map((head) => head.dataset.title);
}

// Numbers in full, as they were measured.
function toCsv(table) {
  const quote = (text) => (/[",\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text);
  const rows = [...table.tBodies[0].rows].map((row) => [...row.cells].map((cell) => String(cell.dataset.value ?? cell.textContent)));
  return [headings(table), ...rows].map((row) => row.map(quote).join(",")).join("\n") + "\n";
}

const LATEX = { "\\": "\\textbackslash{}", "~": "\\textasciitilde{}", "^": "\\textasciicircum{}" };

function escapeLatex(text) {
  return text.replace(/[\\~^&%$#_{}]/g, (letter) => LATEX[letter] ?? `\\${letter}`);
}

// Numbers as the table shows them, for the package booktabs; the best are bold here as well.
function toLatex(table) {
  const heads = [...table.tHead.rows[0].cells];
  const columns = heads.map((head) => (head.classList.contains("number") ? "r" : "l")).join("");
  const line = (cells) => `  ${cells.join(" & ")} \\\\`;
  const rows = [...table.tBodies[0].rows].map((row) =>
    line([...row.cells].map((cell) => {
      const text = escapeLatex(cell.textContent.trim()).replace("∞", "$\\infty$").replace(/^[-−](?=[\d.$])/, "$-$");
      return cell.classList.contains("best") ? `\\textbf{${text}}` : text;
    })),
  );
  return [
    `\\begin{tabular}{${columns}}`,
    "  \\toprule",
    line(headings(table).map(escapeLatex)),
    "  \\midrule",
    ...rows,
    "  \\bottomrule",
    "\\end{tabular}",
    "",
  ].join("\n");
}

// Copies text; pages opened from a file have no clipboard of the newer kind.
async function copyText(text) {
  try {
    await navigator.clipboard.writeText(text);
    return true;
  } catch {
    const area = document.createElement("textarea");
    const focused = document.activeElement;
    area.value = text;
    area.className = "offscreen";
    document.body.append(area);
    area.select();
    const copied = document.execCommand("copy");
    area.remove();
    focused?.focus({ preventScroll: true });
    return copied;
  }
}

function prepareTables(root) {
  for (const section of root.querySelectorAll(".table")) {
    const table = section.querySelector("table");
    table.tHead.querySelectorAll("button").forEach((button, column) => {
      button.addEventListener("click", () => {
        const head = button.closest("th");
        const now = head.getAttribute("aria-sort");
        const descending = now ? now === "ascending" : head.dataset.better === "higher";
        sortTable(table, column, descending);
      });
    });
    const status = section.querySelector("[role=status]");
    for (const button of section.querySelectorAll("[data-copy]")) {
      button.addEventListener("click", async () => {
        const text = button.dataset.copy === "csv" ? toCsv(table) : toLatex(table);
        status.textContent = (await copyText(text)) ? "copied" : "the browser does not allow it";
        setTimeout(() => (status.textContent = ""), 2500);
      });
    }
  }
}
