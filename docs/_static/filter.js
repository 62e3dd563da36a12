// A field above each searchable table, which hides the rows that do not hold its words.
document.addEventListener("DOMContentLoaded", () => {
  document.querySelectorAll(".searchable").forEach((box) => {
    const field = document.createElement("input");
    field.type = "search";
    field.placeholder = "Filter, e.g. alpha or holds";
    field.setAttribute("aria-label", "Filter the rows of the table");
    field.className = "form-control searchable-field";
    field.addEventListener("input", () => {
      const words = field.value.toLowerCase().split(/\s+/).filter(Boolean);
      box.querySelectorAll("tbody tr").forEach((row) => {
        const text = row.textContent.toLowerCase();
        row.hidden = !words.every((word) => text.includes(word));
      });
    });
    box.prepend(field);
  });
});
