// The reference page's search, and its calls of this server. The page reads as well without.
"use strict";

const search = document.getElementById("search");
const nothing = document.getElementById("nothing");
const sections = [...document.querySelectorAll("main section[id]")].map((section) => ({
  section,
  entry: document.querySelector(`nav a[href="#${CSS.escape(section.id)}"]`)?.parentElement,
  text: section.textContent.toLowerCase(),
}));

// Shows what holds every word.
function filter() {
  const words = search.value.toLowerCase().split(/\s+/).filter(Boolean);
  let shown = 0;
  for (const { section, entry, text } of sections) {
    const fits = words.every((word) => text.includes(word));
    section.hidden = !fits;
    if (entry) entry.hidden = !fits;
    shown += fits ? 1 : 0;
  }
  nothing.hidden = shown > 0;
}
search.addEventListener("input", filter);
search.closest("[hidden]").hidden = false;
document.addEventListener("keydown", (event) => {
  if (event.key === "/" && !/^(INPUT|TEXTAREA)$/.test(document.activeElement.tagName)) {
    event.preventDefault();
    search.focus();
  }
});

function element(name, properties, ...children) {
  const made = Object.assign(document.createElement(name), properties);
  made.append(...children);
  return made;
}

// What was opened by a call is used by the next ones.
const known = {};
const token = document.getElementById("token");

function field(form, parameter) {
  const input = element("input", { name: parameter.name, value: known[parameter.name] ?? parameter.example ?? "" });
  input.dataset.place = parameter.in;
  input.required = parameter.required === true;
  form.append(element("label", {}, parameter.name, element("span", { className: "quiet" }, ` in the ${parameter.in}`), input));
  return input;
}

async function told(answer) {
  const type = answer.headers.get("content-type") ?? "";
  if (/json|text/.test(type) && !/ndjson/.test(type)) {
    const text = await answer.text();
    try {
      return element("pre", { tabIndex: 0 }, JSON.stringify(JSON.parse(text), null, 2));
    } catch {
      return element("pre", { tabIndex: 0 }, text);
    }
  }
  const bytes = await answer.blob();
  const name = /filename="([^"]+)"/.exec(answer.headers.get("content-disposition") ?? "")?.[1] ?? "answer";
  const link = element("a", { href: URL.createObjectURL(bytes), download: name }, `save ${name}`);
  return element("p", {}, `${type || "no body"}, ${bytes.size.toLocaleString("en")} bytes `, bytes.size > 0 ? link : "");
}

function attempt(call) {
  const form = element("form", {});
  const inputs = (call.parameters ?? []).filter((p) => p.in !== "header").map((parameter) => field(form, parameter));
  let body = null;
  let file = null;
  if (call.json) {
    body = element("textarea", { value: JSON.stringify(call.json, null, 2), spellcheck: false });
    form.append(element("label", {}, "body", body));
  } else if (call.file) {
    file = element("input", { type: "file" });
    form.append(element("label", {}, "model (none with sample)", file));
  }
  const send = element("button", {}, "Send");
  const output = element("div", { ariaLive: "polite" });
  form.append(send, output);
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    let path = call.path;
    const query = new URLSearchParams();
    for (const input of inputs) {
      if (input.dataset.place === "path") path = path.replace(`{${input.name}}`, encodeURIComponent(input.value));
      else if (input.value !== "" && !(file?.files[0] && input.name === "sample")) query.set(input.name, input.value);
    }
    const headers = {};
    if (token.value) headers.authorization = `Bearer ${token.value}`;
    if (body) headers["content-type"] = "application/json";
    send.disabled = true;
    output.replaceChildren("…");
    try {
      const started = performance.now();
      const address = query.size > 0 ? `${path}?${query}` : path;
      const answer = await fetch(address, { method: call.method, headers, body: body?.value ?? file?.files[0] });
      const shown = await told(answer.clone());
      const status = element("strong", { className: answer.ok ? "good" : "bad" }, `${answer.status} ${answer.statusText}`);
      const ms = Math.round(performance.now() - started);
      const made = (await answer.json().catch(() => null))?.id;
      if (answer.ok && typeof made === "string") remember("id", made);
      output.replaceChildren(element("p", {}, status, ` in ${ms} ms, request ${answer.headers.get("x-request-id") ?? "?"}`), shown);
    } catch (problem) {
      output.replaceChildren(element("p", { className: "bad" }, `no answer: ${problem.message}`));
    }
    send.disabled = false;
  });
  return form;
}

function remember(name, value) {
  known[name] = value;
  for (const input of document.querySelectorAll(`form input[name="${name}"]`)) input.value = value;
}

for (const place of document.querySelectorAll("[data-call]")) {
  const call = JSON.parse(place.dataset.call);
  const more = element("details", {}, element("summary", {}, "Try it"));
  more.addEventListener("toggle", () => more.open && more.childElementCount === 1 && more.append(attempt(call)));
  place.replaceWith(more);
}
