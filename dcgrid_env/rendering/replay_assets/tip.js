"use strict";
// The box next to the pointer or the focus, and the words that it explains.

const byId = (id) => document.getElementById(id);

function element(parent, tag, text = "", attributes = {}) {
  const made = parent.appendChild(document.createElement(tag));
  made.textContent = text;
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  return made;
}

function showTip(text, left, top) {
  const tip = byId("tip");
  tip.hidden = false;
  tip.textContent = text;
  tip.style.left = Math.max(4, Math.min(left, window.innerWidth - tip.offsetWidth - 6)) + "px";
  tip.style.top = Math.max(4, Math.min(top, window.innerHeight - tip.offsetHeight - 6)) + "px";
}

const hideTip = () => { byId("tip").hidden = true; };

// Adds a text in which each word of the terms is a button that explains it under the pointer, in focus or when tapped.
function withTerms(parent, text, terms) {
  const words = Object.keys(terms).map((word) => word.replaceAll(".", "\\.")).join("|");
  for (const part of text.split(new RegExp(`(?<!\\w)(${words})(?!\\w)`))) {
    if (!(part in terms)) {
      parent.append(part);
      continue;
    }
    const button = element(parent, "button", part, { type: "button", class: "term", "aria-describedby": "tip" });
    const explain = () => {
      const { left, bottom } = button.getBoundingClientRect();
      showTip(terms[part], left, bottom + 4);
    };
    for (const begin of ["pointerenter", "focus", "click"]) button.addEventListener(begin, explain);
    for (const end of ["pointerleave", "blur"]) button.addEventListener(end, hideTip);
  }
}
