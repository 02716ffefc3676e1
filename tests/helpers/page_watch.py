"""A reader who presses everything on a page, and what the page asks of the world meanwhile."""

import contextlib
import socketserver
import threading
from dataclasses import dataclass, field

import pytest

PlaywrightError = pytest.importorskip("playwright.sync_api").Error

# Finds what can be pressed and is seen, by a name that it keeps when a plot is drawn anew. Links to
# files beside the page are left out.
_FIND = """(() => {
  const kinds = "a, button, input, select, textarea, summary, label, [tabindex], [onclick], "
    + "[role=button], [role=link], [role=menuitem], [role=tab], [contenteditable]";
  const heard = ["click", "dblclick", "mousedown", "mouseup", "pointerdown", "pointerup"];
  const counts = new Map();
  window.pressable = new Map();
  for (const part of document.body.querySelectorAll("*")) {
    if (!part.matches(kinds)) {
      const listeners = getEventListeners(part);
      if (!heard.some((kind) => kind in listeners)) continue;
    }
    if (part.protocol === "file:" && !part.getAttribute("href").startsWith("#")) continue;
    const box = part.getBoundingClientRect();
    if (!box.width || !box.height || getComputedStyle(part).visibility !== "visible") continue;
    const place = part.closest(".canvas, form, table, section, body");
    const text = part.dataset.title || part.getAttribute("aria-label") || part.textContent;
    const target = part.href ? "link:" + (part.href.baseVal ?? part.href) : part.tagName;
    const words = [place.id || place.tagName, target, part.getAttribute("class")];
    const name = [...words, text.slice(0, 40)].join(" ");
    counts.set(name, (counts.get(name) || 0) + 1);
    window.pressable.set(name + " " + counts.get(name), part);
  }
  return [...window.pressable.keys()];
})()"""
# The middle of a part in view, and whether nothing lies over it; null where it has gone.
_AIM = """(name) => {
  const part = window.pressable.get(name);
  part.scrollIntoView({ block: "center", inline: "center", behavior: "instant" });
  const box = part.getBoundingClientRect();
  const [x, y] = [box.x + box.width / 2, box.y + box.height / 2];
  const top = document.elementFromPoint(x, y);
  return box.width && box.height ? { x, y, free: part.contains(top) } : null;
}"""
_CLICK = "(name) => window.pressable.get(name).click?.()"  # a plot's areas have none
# Where the keys go. What a browser builds into a film is one place.
_FOCUS = """() => {
  const part = document.activeElement;
  window.reached = window.reached || new Map();
  if (!window.reached.has(part)) window.reached.set(part, window.reached.size);
  const file = part.protocol === "file:" && !part.getAttribute("href").startsWith("#");
  return { number: window.reached.get(part), tag: part.tagName, file };
}"""
# Of what stood there before the tour: messages of a plot come and go by themselves.
_TO_REACH = """(selector) => {
  const seen = (part) => getComputedStyle(part).visibility === "visible";
  const shown = (part) => part.getClientRects().length && seen(part);
  const parts = [...document.querySelectorAll(selector)];
  window.to_reach = parts.filter((part) => shown(part) && !part.closest(".plotly-notifier"));
}"""
_MISSED = """() => window.to_reach
  .filter((part) => part.isConnected && !window.reached.has(part))
  .map((part) => part.outerHTML.slice(0, 120))"""
_FOCUS_AGAIN = "(number) => [...window.reached.keys()][number].focus()"

# What a page can try, from where it stands or by leaving, by the host that would hear of it.
STAYING = {
    "fetch": "fetch(to, { method: 'POST', mode: 'no-cors', body: 'x' }).catch(() => 0)",
    "request": "const r = new XMLHttpRequest(); r.open('POST', to); r.send('x')",
    "beacon": "navigator.sendBeacon(to, 'x')",
    "socket": "new WebSocket(to.replace('http', 'ws'))",
    "events": "new EventSource(to)",
    "worker": "new Worker(URL.createObjectURL(new Blob([`fetch('${to}', { mode: 'no-cors' })`])))",
    "image": "add('img', { src: to })",
    "background": "add('p', { style: `background: url(${to})` }).textContent = 'x'",
    "sheet": "add('link', { rel: 'stylesheet', href: to })",
    "prefetch": "add('link', { rel: 'prefetch', href: to })",
    "icon": "add('link', { rel: 'icon', href: to })",
    "font": "new FontFace('f', `url(${to})`).load().catch(() => 0)",
    "script": "add('script', { src: to })",
    "frame": "add('iframe', { src: to })",
    "object": "add('object', { data: to })",
    "embed": "add('embed', { src: to })",
    "video": "add('video', { src: to })",
    "form-in-a-frame": "add('iframe', { name: 'f' }); "
    "add('form', { action: to, method: 'post', target: 'f' }).submit()",
    "base": "add('base', { href: to }); "
    "add('a', { href: document.baseURI === to ? 'x' : '#' }, 'x').click()",
}
LEAVING = {
    "form": "add('form', { action: to, method: 'post' }).submit()",
    "form-in-a-window": "add('form', { action: to, method: 'post', target: '_blank' }).submit()",
    "window": "window.open(to)",
    "window-without-opener": "window.open(to, '', 'noopener')",
    "link": "add('a', { href: to }, 'x').click()",
    "link-in-a-window": "add('a', { href: to, target: '_blank' }, 'x').click()",
    "link-in-a-picture": "draw('a', draw('svg', document.body), to)"
    ".dispatchEvent(new MouseEvent('click', { bubbles: true, cancelable: true }))",
    "jump": "location.href = to",
    "refresh": "add('meta', { 'http-equiv': 'refresh', content: `0; url=${to}` })",
}
FORMS = ("form", "form-in-a-window", "form-in-a-frame")
_TRY = """(to) => {
  const add = (tag, attributes, text = "") => {
    const part = document.createElement(tag);
    for (const [name, value] of Object.entries(attributes)) part.setAttribute(name, value);
    part.textContent = text;
    (["BASE", "META", "LINK"].includes(part.tagName) ? document.head : document.body).append(part);
    return part;
  };
  const draw = (tag, place, href = "") => {
    const part = place.appendChild(document.createElementNS("http://www.w3.org/2000/svg", tag));
    part.setAttribute("href", href);
    return part;
  };
  CODE
}"""

_SILENT = "a connection over which nothing came"


class _Wire(socketserver.ThreadingTCPServer):
    """A proxy that lets nothing through and keeps the first line of what comes."""

    daemon_threads = True

    def __init__(self):
        super().__init__(("127.0.0.1", 0), _Refuse)
        self.lines: list[str] = []
        self.lock = threading.Lock()


class _Refuse(socketserver.StreamRequestHandler):
    timeout = 5

    def handle(self):
        with self.server.lock:
            number = len(self.server.lines)
            self.server.lines.append(_SILENT)
        with contextlib.suppress(OSError):
            line = self.rfile.readline(4096).decode(errors="replace").strip()
            self.server.lines[number] = line or _SILENT
            # An answer without content: a page that goes there stays where it is.
            self.wfile.write(b"HTTP/1.1 204 No Content\r\nConnection: close\r\n\r\n")


@dataclass
class Watch:
    """What a page asked for.

    Attributes:
        wire: First lines of all connections that the browser made for it.
        requests: Addresses that it was to load, blocked or not.
        windows: Addresses of windows beside its own.
        downloads: Addresses of what it saved as files.
        complaints: Warnings and errors.
    """

    wire: list[str]
    requests: list[str] = field(default_factory=list)
    windows: list[str] = field(default_factory=list)
    downloads: list[str] = field(default_factory=list)
    complaints: list[str] = field(default_factory=list)

    def sent(self):
        """What came over the wire; Chromium also connects, silently, for frames that it blocks."""
        return [line for line in self.wire if line != _SILENT]

    def outward(self):
        """All that left the page, or was to."""
        asked = [*self.requests, *self.downloads]
        asked = [url for url in asked if not url.startswith(("file:", "data:", "blob:"))]
        return [*self.wire, *asked, *(f"window {url}" for url in self.windows)]


@contextlib.contextmanager
def watched(browser, **options):
    """An empty page whose every connection ends here, and the watch over it."""
    with _Wire() as wire:
        threading.Thread(target=wire.serve_forever, args=(0.05,), daemon=True).start()
        proxy = {"server": f"http://127.0.0.1:{wire.server_address[1]}"}
        context = browser.new_context(proxy=proxy, **options)
        watch, page = Watch(wire.lines), context.new_page()
        context.on("request", lambda request: watch.requests.append(request.url))
        _watch_windows(browser, page, watch.windows)
        page.on("download", lambda download: watch.downloads.append(download.url))
        page.on("pageerror", lambda error: watch.complaints.append(str(error)))
        page.on("console", lambda m: watch.complaints.append(m.text) if m.type != "log" else None)
        try:
            yield page, watch
        finally:
            context.close()
            wire.shutdown()


def _watch_windows(browser, page, windows):
    """Keeps what windows open beside a page, loaded or not."""
    own = page.context.new_cdp_session(page).send("Target.getTargetInfo")["targetInfo"]
    session = browser.new_browser_cdp_session()

    def created(event):
        found = event["targetInfo"]
        ours = found.get("browserContextId") == own["browserContextId"]
        if ours and found["type"] == "page" and found["targetId"] != own["targetId"]:
            windows.append(found["url"])

    session.on("Target.targetCreated", created)
    session.send("Target.setDiscoverTargets", {"discover": True})


def load(page, path):
    """Loads a page from disk and waits for its plots."""
    page.goto(path.as_uri())
    if page.locator("#plot-data").count():
        page.wait_for_selector("html[data-ready=yes]", state="attached")


def attempt(page, names):
    """Lets the page try what `STAYING` and `LEAVING` name, one after the other.

    Each goes to the host of its name. A way out that is open is heard of before this returns.
    """
    for name in names:
        code = (STAYING | LEAVING)[name]
        with contextlib.suppress(PlaywrightError):  # some of what is forbidden is an error
            page.evaluate(_TRY.replace("CODE", code), f"http://{name}.example/")
        page.wait_for_timeout(100)
    page.wait_for_timeout(1000)


def press_by_mouse(page):
    """Presses all that can be pressed, and what comes up while that is done, each thing once.

    Returns:
        Names of what was pressed, in this order.
    """
    session = page.context.new_cdp_session(page)
    arguments = {"expression": _FIND, "includeCommandLineAPI": True, "returnByValue": True}
    known, waiting, done = set(), [], []
    while True:
        found = session.send("Runtime.evaluate", arguments)["result"]["value"]
        # What has just come up is pressed first: another press may close it.
        waiting += [name for name in found if name not in known]
        known.update(found)
        there = [name for name in waiting if name in found]
        if not there:
            return done
        name = there[-1]
        waiting.remove(name)
        aim = page.evaluate(_AIM, name)
        if aim is not None:
            page.mouse.click(aim["x"], aim["y"])
            if not aim["free"]:
                page.evaluate(_CLICK, name)
            done.append(name)


_MENU = "overflow-button"
_PATIENCE = 100  # times 150 ms


def press_film_controls(page):
    """Presses what the browser builds into a film: play, sound, full screen, and its menu.

    Returns:
        Names of what was pressed.
    """
    session, done, idle, hidden = page.context.new_cdp_session(page), set(), 0, 0
    page.locator("video").scroll_into_view_if_needed()
    while idle < 3:
        shown = _film_controls(session)
        new = [name for name in shown if name not in done]
        # The menu closes at each press within it, and is opened for the next one.
        name = next((name for name in (*new, *shown) if name in new or _MENU in name), None)
        if name is None:  # the controls hide while a film plays, and a busy machine shows them late
            assert hidden < _PATIENCE, f"a film without its menu; shown: {sorted(shown)}"
            hidden += 1
            page.locator("video").hover(force=True)
            page.wait_for_timeout(150)
            continue
        idle = 0 if new else idle + 1
        part = session.send("DOM.resolveNode", {"backendNodeId": shown[name]})["object"]["objectId"]
        press = {"functionDeclaration": "function () { this.click() }", "userGesture": True}
        session.send("Runtime.callFunctionOn", {"objectId": part, **press})
        page.wait_for_timeout(150)
        done.add(name)
    page.evaluate("document.fullscreenElement && document.exitFullscreen()")
    page.evaluate("document.pictureInPictureElement && document.exitPictureInPicture()")
    page.keyboard.press("Escape")  # an open menu keeps the keys
    return done


def _film_controls(session):
    """Numbers of the nodes that a browser builds into a film and shows, by name."""
    root = session.send("DOM.getDocument", {"depth": 0})["root"]["nodeId"]
    film = session.send("DOM.querySelector", {"nodeId": root, "selector": "video"})["nodeId"]
    whole = {"nodeId": film, "depth": -1, "pierce": True}
    found, waiting = {}, [session.send("DOM.describeNode", whole)["node"]]
    while waiting:
        node = waiting.pop()
        waiting += node.get("children", []) + node.get("shadowRoots", [])
        if node["nodeName"] not in ("INPUT", "LABEL"):
            continue
        told = node["attributes"]
        told = dict(zip(told[::2], told[1::2], strict=True))
        with contextlib.suppress(PlaywrightError):  # what is not shown has no box
            session.send("DOM.getBoxModel", {"backendNodeId": node["backendNodeId"]})
            found[f"{told.get('pseudo')} {told.get('aria-label')}"] = node["backendNodeId"]
    return found


def press_by_keys(page, focusable):
    """Presses enter and space wherever the tabulator leads, once round the page.

    Args:
        page: The page.
        focusable: Selector of what the tabulator has to come to where it is seen.

    Returns:
        Number of places, 0 where the tabulator does not come round; and the beginnings of those
        parts of `focusable` that it passed by.
    """
    previous = -1
    page.evaluate(_TO_REACH, focusable)
    page.evaluate("() => { window.reached = new Map(); }")
    for _ in range(300):
        page.keyboard.press("Tab")
        focus = page.evaluate(_FOCUS)
        if focus["number"] < previous:
            return previous + 1, page.evaluate(_MISSED)
        again = focus["number"] == previous  # within a film
        previous = focus["number"]
        if focus["file"] or again:
            continue
        for key in ("Enter", "Space"):
            page.keyboard.press(key)
            page.evaluate(_FOCUS_AGAIN, previous)
    return 0, page.evaluate(_MISSED)


def choose_everything(page):
    """Takes each option of each list."""
    for chooser in page.locator("select:visible").all():
        for i in range(chooser.locator("option").count()):
            chooser.select_option(index=i)
            page.wait_for_timeout(50)


def linked_files(page):
    """Addresses of the links that lead from the page."""
    links = page.locator("a[href]:not([href^='#'])")
    return links.evaluate_all("links => links.map((link) => link.href.baseVal ?? link.href)")
