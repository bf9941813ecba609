// Sorts and filters the cards. Without it their order is failures, outliers, names.
(() => {
  const list = document.getElementById("cards"), tools = document.getElementById("tools");
  const find = tools.querySelector("input"), shown = tools.querySelector("output");
  const buttons = [...tools.querySelectorAll("button")];
  const cards = [...list.children].map((card, order) =>
    ({ order, ...card.dataset, card, name: card.querySelector(".name").textContent }));
  const byName = new Intl.Collator("en", { numeric: true }).compare;
  let key = "order", sign = 1;

  const compare = (a, b) => {
    if (key === "name") return sign * byName(a.name, b.name);
    // What has no value comes last, whichever way.
    const missing = (a[key] === undefined) - (b[key] === undefined);
    return missing || sign * (a[key] - b[key]) || a.order - b.order;
  };
  const sort = button => {
    sign = button.dataset.key === key ? -sign : 1;
    key = button.dataset.key;
    list.append(...cards.sort(compare).map(c => c.card));
    for (const b of buttons) {
      b.setAttribute("aria-pressed", b === button);
      b.querySelector("span").textContent = b !== button ? "" : sign > 0 ? " \u2191" : " \u2193";
    }
  };
  const filter = () => {
    const wanted = find.value.trim().toLowerCase();
    for (const c of cards) c.card.hidden = !c.name.toLowerCase().includes(wanted);
    shown.textContent = `${list.querySelectorAll("li:not([hidden])").length} of ${cards.length} shown`;
  };
  for (const b of buttons) b.onclick = () => sort(b);
  find.oninput = filter;
  // A link to a card that is filtered out shows all of them.
  addEventListener("hashchange", () => { find.value = ""; filter(); document.querySelector(":target")?.scrollIntoView(); });
  tools.hidden = false;
})();
