(function () {
  "use strict";
  var data = JSON.parse(document.getElementById("data").textContent);
  var all = function (selector, from) {
    return Array.prototype.slice.call((from || document).querySelectorAll(selector));
  };
  document.documentElement.classList.add("js");
  all(".with-script").forEach(function (e) { e.hidden = false; });

  function element(name, mark, text) {
    var e = document.createElement(name);
    if (mark) e.className = mark;
    if (text !== undefined) e.textContent = text;
    return e;
  }
  function card(id) {
    return all(".card").filter(function (c) { return c.dataset.id === id; })[0];
  }

  // A tooltip describes the point at the pointer. SVG titles would show the same text again.
  var tip = document.getElementById("tip"), current = null;
  all("svg title").forEach(function (t) {
    t.parentNode.setAttribute("aria-label", t.textContent);
    t.remove();
  });
  function fill(id) {
    var p = data.points[id];
    tip.textContent = "";
    tip.append(element("b", "", p.label), element("p", "", "error " + p.error + " · " + p.time),
      element("p", "", p.range + ", " + p.frames));
    if (p.against) tip.append(element("p", "", p.against));
    var table = element("table"), body = element("tbody");
    p.settings.forEach(function (s) {
      var row = element("tr", s[2] ? "changed" : "");
      row.append(element("td", "", s[0]), element("td", "", s[1]));
      body.append(row);
    });
    table.append(body);
    tip.append(table);
    var c = card(id);
    if (c) {
      var pair = element("div", "pair");
      [".picture", document.getElementById("scale-each").checked ? "img.each" : "img.shared"]
        .forEach(function (s) {
          var from = c.querySelector(s);
          if (from) { var i = element("img"); i.src = from.src; i.alt = ""; pair.append(i); }
        });
      tip.append(pair);
    }
  }
  function mark(id) {
    if (id === current) return;
    current = id;
    all("svg .pt:not(.ghost), #all tbody tr").forEach(function (e) {
      e.classList.toggle("at", e.dataset.id === id);
    });
    if (id) fill(id);
    tip.hidden = !id;
  }
  function put(x, y) {
    var w = tip.offsetWidth, h = tip.offsetHeight, gap = 16;
    var left = x + gap + w > innerWidth ? x - gap - w : x + gap;
    var top = y + gap + h > innerHeight ? y - gap - h : y + gap;
    tip.style.left = Math.max(6, Math.min(left, innerWidth - w - 6)) + "px";
    tip.style.top = Math.max(6, Math.min(top, innerHeight - h - 6)) + "px";
  }
  // The nearest point is selected, however small its circle is.
  function nearest(svg, x, y) {
    var best = null, least = 22 * 22;
    all(".pt:not(.ghost)", svg).forEach(function (c) {
      var box = c.getBoundingClientRect();
      var dx = box.left + box.width / 2 - x, dy = box.top + box.height / 2 - y;
      var d = (dx * dx + dy * dy) * (c.classList.contains("on-front") ? 0.6 : 1);
      if (d < least) { least = d; best = c; }
    });
    return best;
  }
  all("svg").forEach(function (svg) {
    svg.addEventListener("pointermove", function (e) {
      var c = nearest(svg, e.clientX, e.clientY);
      mark(c ? c.dataset.id : null);
      if (c) put(e.clientX, e.clientY);
    });
    svg.addEventListener("pointerleave", function (e) {
      if (e.pointerType === "mouse") mark(null);
    });
    svg.addEventListener("click", function (e) {
      var c = nearest(svg, e.clientX, e.clientY);
      if (!c) { mark(null); return; }
      mark(c.dataset.id);
      put(e.clientX, e.clientY);
      if (e.pointerType !== "touch" && card(c.dataset.id)) open(c.dataset.id, "picture");
    });
  });
  addEventListener("scroll", function () { if (current) mark(null); }, { passive: true });
  all("svg .on-front").forEach(function (c) {
    c.setAttribute("tabindex", "0");
    c.setAttribute("role", "button");
    c.addEventListener("focus", function () {
      if (!c.matches(":focus-visible")) return;
      var box = c.getBoundingClientRect();
      mark(c.dataset.id);
      put(box.right, box.bottom);
    });
    c.addEventListener("blur", function () { mark(null); });
    c.addEventListener("keydown", function (e) {
      if (e.key === "Enter" && card(c.dataset.id)) open(c.dataset.id, "picture");
    });
  });
  all(".headlines li, .knobs tr[data-id], #all tbody tr").forEach(function (row) {
    row.addEventListener("pointerenter", function () {
      all("svg .pt:not(.ghost)").forEach(function (c) {
        c.classList.toggle("at", c.dataset.id === row.dataset.id);
      });
    });
    row.addEventListener("pointerleave", function () {
      all("svg .pt.at").forEach(function (c) { c.classList.remove("at"); });
    });
  });

  // Colours by another tunable.
  var select = document.getElementById("color");
  function className(knob, i) {
    if (!knob.ordered) return "c" + i % 8;
    return "r" + Math.round(7 * i / Math.max(1, knob.values.length - 1));
  }
  function paint(knob) {
    all("svg.wide .pt, svg.narrow .pt").forEach(function (c) {
      c.setAttribute("class", c.getAttribute("class").replace(/\b[cr]\d+\b/,
        className(knob, knob.of[c.dataset.id])));
    });
    var keys = document.getElementById("keys");
    keys.textContent = "";
    knob.values.forEach(function (value, i) {
      var item = element("li");
      item.append(element("i", "key " + className(knob, i)), value);
      keys.append(item);
    });
  }
  if (select && data.knobs.length > 1) {
    data.knobs.forEach(function (knob, i) {
      var option = element("option", "", knob.title);
      option.value = i;
      select.append(option);
    });
    select.value = data.color;
    select.hidden = false;
    document.getElementById("color-name").hidden = true;
    select.addEventListener("change", function () { paint(data.knobs[select.value]); });
  }

  // Sorts the table by any column; rows without a value come last.
  var body = document.querySelector("#all tbody");
  all("#all thead th").forEach(function (head, column) {
    head.setAttribute("tabindex", "0");
    function sort() {
      var up = head.getAttribute("aria-sort") !== "ascending";
      all("#all thead th").forEach(function (h) { h.removeAttribute("aria-sort"); });
      head.setAttribute("aria-sort", up ? "ascending" : "descending");
      function value(row) {
        var cell = row.children[column];
        if (head.dataset.kind === "text") return cell.textContent;
        if (cell.dataset.v === "") return null;
        return cell.dataset.v === "inf" ? Infinity : Number(cell.dataset.v);
      }
      all("tr", body).sort(function (a, b) {
        var x = value(a), y = value(b);
        if (x === null || y === null) return (x === null) - (y === null);
        var order = typeof x === "string" ? x.localeCompare(y, undefined, { numeric: true })
          : x < y ? -1 : x > y ? 1 : 0;
        return up ? order : -order;
      }).forEach(function (row) { body.append(row); });
    }
    head.addEventListener("click", sort);
    head.addEventListener("keydown", function (e) {
      if (e.key === "Enter" || e.key === " ") { e.preventDefault(); sort(); }
    });
  });

  // The viewer shows pictures alternately in the same position, so that changes are visible.
  var viewer = document.getElementById("viewer");
  var shown = { id: null, what: "picture" };
  var ids = all(".card").map(function (c) { return c.dataset.id; });
  var kinds = [["picture", "picture"], ["exact", "exact"], ["shared", "difference, one scale"],
    ["each", "difference, its own scale"]];
  function show() {
    var from = card(shown.what === "exact" ? "reference" : shown.id);
    var selector = { shared: "img.shared", each: "img.each" }[shown.what] || ".picture";
    var image = from.querySelector(selector) || from.querySelector(".picture");
    document.getElementById("viewer-image").src = image.src;
    document.getElementById("viewer-image").alt = image.alt;
    var p = data.points[shown.id];
    document.getElementById("viewer-name").textContent =
      p ? p.label + " · error " + p.error + " · " + p.time : "The exact integral";
    all("button", document.getElementById("viewer-what")).forEach(function (b) {
      b.setAttribute("aria-pressed", b.dataset.what === shown.what);
      b.hidden = shown.id === "reference" && b.dataset.what !== "picture";
    });
  }
  function open(id, what) {
    shown = { id: id, what: id === "reference" ? "picture" : what };
    mark(null);
    show();
    if (!viewer.open) viewer.showModal();
  }
  kinds.forEach(function (kind) {
    var button = element("button", "", kind[1]);
    button.type = "button";
    button.dataset.what = kind[0];
    button.addEventListener("click", function () { shown.what = kind[0]; show(); });
    document.getElementById("viewer-what").append(button);
  });
  document.getElementById("viewer-close")
    .addEventListener("click", function () { viewer.close(); });
  viewer.addEventListener("click", function (e) { if (e.target === viewer) viewer.close(); });
  viewer.addEventListener("keydown", function (e) {
    var step = { ArrowLeft: -1, ArrowRight: 1 }[e.key];
    if (step) {
      shown.id = ids[(ids.indexOf(shown.id) + step + ids.length) % ids.length];
      if (shown.id === "reference") shown.what = "picture";
      show();
    } else if (e.key === " " && shown.id !== "reference") {
      shown.what = shown.what === "exact" ? "picture" : "exact";
      show();
    } else {
      return;
    }
    e.preventDefault();
  });
  all(".card img").forEach(function (image) {
    image.addEventListener("click", function () {
      open(image.closest(".card").dataset.id, image.classList[0]);
    });
  });
})();
