// What the page does beside turning the solid: values under the pointer, headings of tables in a
// narrow window, pictures that enlarge.
"use strict";
(() => {
  const tip = document.createElement("div");
  tip.className = "tip";
  tip.hidden = true;
  document.body.append(tip);

  function show(text, x, y) {
    tip.textContent = text;
    tip.hidden = !text;
    if (!text) return;
    const width = document.documentElement.clientWidth;
    tip.style.left = `${Math.max(4, Math.min(x + 12, width - tip.offsetWidth - 4))}px`;
    tip.style.top = `${Math.max(4, y - tip.offsetHeight - 12)}px`;
  }

  // the values of a curve lie in the drawing as invisible circles with a title
  for (const plot of document.querySelectorAll("svg.plot")) {
    const values = [...plot.querySelectorAll("circle.value")].map((circle) => {
      const title = circle.querySelector("title"), text = title.textContent;
      title.remove(); // else the browser would show a second one
      return { circle, text };
    });
    if (!values.length) continue;
    plot.addEventListener("pointermove", (event) => {
      let nearest = null, least = 28;
      for (const value of values) {
        const box = value.circle.getBoundingClientRect();
        const away = Math.hypot(event.clientX - box.left - box.width / 2, event.clientY - box.top - box.height / 2);
        value.circle.classList.remove("shown");
        if (away < least) [nearest, least] = [value, away];
      }
      if (nearest) nearest.circle.classList.add("shown");
      show(nearest ? nearest.text : "", event.clientX, event.clientY);
    });
    plot.addEventListener("pointerleave", () => {
      values.forEach(({ circle }) => circle.classList.remove("shown"));
      show("", 0, 0);
    });
  }
  document.addEventListener("tip", ({ detail }) => show(detail.text, detail.x, detail.y));

  // headings of the cells, for a narrow window, counted from the right: left ones may span rows
  for (const table of document.querySelectorAll(".wide table")) {
    const headings = [...table.querySelectorAll("thead th")].map((cell) => cell.textContent);
    for (const row of table.querySelectorAll("tbody tr")) {
      let at = headings.length;
      for (const cell of [...row.cells].reverse()) {
        at -= cell.colSpan;
        cell.dataset.heading = headings[at] || "";
      }
    }
  }

  const frame = document.createElement("dialog");
  frame.className = "large";
  frame.append(document.createElement("img"), document.createElement("p"));
  frame.addEventListener("click", () => frame.close());
  document.body.append(frame);
  for (const picture of document.querySelectorAll(".screws img")) {
    const open = () => {
      Object.assign(frame.firstChild, { src: picture.src, alt: picture.alt });
      frame.lastChild.textContent = picture.alt;
      frame.showModal();
    };
    Object.assign(picture, { tabIndex: 0, title: "Enlarge" });
    picture.setAttribute("role", "button");
    picture.addEventListener("click", open);
    picture.addEventListener("keydown", (event) => {
      if (event.key !== "Enter" && event.key !== " ") return;
      event.preventDefault();
      open();
    });
  }
})();
