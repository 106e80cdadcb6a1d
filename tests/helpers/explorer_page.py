"""The page in a browser, Debian's Chromium, and all that it has said and asked for."""

import shutil
import time
from functools import partial

import explorer_server
import jax.numpy as jnp

import walker_jax as wj
from walker_jax.explorer import pictures
from walker_jax.explorer.offers import offer

CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
)
REQUIRED = "WALKER_JAX_REQUIRE_BROWSER"
WIDE, NARROW = {"width": 1280, "height": 800}, {"width": 400, "height": 860}
SECONDS = 90
"""For which a page may take, on a machine that others use."""
AREA = 0.0012073
"""Of the basin at slope 0.004 in the home window, by `refine` on 4 levels."""
GAIT = {
    "period": 1,
    "states": [[0.153389560, -0.156080151]],
    "multipliers": [[0.6339, 0.0], [0.0, 0.0]],
    "times": [3.88],
    "stable": True,
}
NO_STORAGE = """Object.defineProperty(window, "localStorage", {
  get() { throw new DOMException("storage is refused", "SecurityError"); }
})"""
MEASURED = {
    "gaits": [GAIT],
    "area": {"area": AREA, "error": 1e-6},
    "disturbance": {
        "size": 0.002256,
        "gait": [0.15338956, -0.15608015],
        "failure": 1,
        "strides": 18,
    }
    | {"state": [0.15496238, -0.15446256]},
}
"""What workers would compute in the time that a page is open: some seconds of two processors."""


class Own(wj.SimplestWalker):
    """The simplest walker, of a user's own."""


OWN = offer(Own(0.004))


class Spiral(wj.System):
    """Three numbers, of which two turn about the third, and escape where that is large."""

    turn: float = 0.5

    section = "east", "north", "up"
    failures = ("flies_off",)

    def advance(self, x):
        cos, sin = 0.9 * jnp.cos(self.turn), 0.9 * jnp.sin(self.turn)
        flies = jnp.where(x[2] > 1, self.failure("flies_off"), wj.Outcome.STRIDE)
        up = jnp.where(x[2] > 0.5, 1.5, 0.5) * x[2]
        return jnp.stack([cos * x[0] - sin * x[1], sin * x[0] + cos * x[1], up]), flies, 1.0

    def feasible(self, x):
        return x[0] > -1.5

    def gait_region(self):
        return wj.Grid.plain(east=(-2, 2, 4), north=(-2, 2, 4), up=(-2, 2, 4))


def fulfil(found, route):
    """Answer a request in the server's place."""
    route.fulfill(json=found)


def fulfil_as(answer, route):
    route.fulfill(**answer)


class Page:
    """The page, and all that it has said and asked for."""

    def __init__(self, browser, port, state="", *, measured=MEASURED, before="", **options):
        self.context = browser.new_context(**{"viewport": WIDE, "accept_downloads": True} | options)
        self.context.add_init_script(before)
        self.context.grant_permissions(["clipboard-read", "clipboard-write"])
        self.page = self.context.new_page()
        self.said, self.addresses = [], []
        self.page.on("console", lambda message: self.said.append(message.text))
        self.page.on("pageerror", lambda error: self.said.append(str(error)))
        self.page.on("request", lambda request: self.addresses.append(request.url))
        self.port = port
        for kind, found in measured.items():
            self.page.route(f"**/api/measure/{kind}", partial(fulfil, found))
        self.page.goto(f"http://127.0.0.1:{port}/?token={explorer_server.TOKEN}#{state}")
        self.finished()

    def value(self, expression):
        return self.page.evaluate(expression)

    def wait(self, expression, seconds=SECONDS):
        """Wait until an expression holds; the page's policy lets Playwright's own wait not run."""
        stop = time.monotonic() + seconds
        while time.monotonic() < stop:
            if self.value(expression):
                return
            self.page.wait_for_timeout(20)
        raise AssertionError(f"not within {seconds} s: {expression}; {self.said}")

    def finished(self):
        """Wait for the whole picture."""
        self.wait("Boolean(window.explorer?.picture.layer) && explorer.picture.progress === 1")

    def walks_from_start(self):
        """Wait until it walks from the start that was chosen; until then it shows the gait."""
        chosen = "JSON.stringify(explorer.state.start)"
        self.wait(f"explorer.state.start && {chosen} === JSON.stringify(explorer.walk.start)")

    def shown(self, selector):
        return self.page.locator(selector).inner_text()

    def box(self, selector="#map"):
        return self.page.locator(selector).bounding_box()

    def screen(self, theta, total):
        """Where a point of the sheared section is on the screen."""
        at = self.value(f"explorer.map.toScreen(...explorer.map.places([{theta}, {total}]))")
        box = self.box()
        return box["x"] + at[0], box["y"] + at[1]

    def set_slope(self, slope):
        self.page.fill("#parameters .typed", str(slope))
        self.wait(f"JSON.parse(explorer.picture.layer.key).parameters.slope === {slope}")
        self.finished()

    def close(self):
        assert not self.said, self.said
        own = (f"http://127.0.0.1:{self.port}/", "blob:", "data:")
        assert all(address.startswith(own) for address in self.addresses)
        self.context.close()


CELLS = """(() => {
  const {picture, map} = explorer, found = picture.cells(map.view);
  return {level: found.level, all: found.all, area: explorer.lattice.cellArea(found.level)};
})()"""
WALKING = f"""(() => {{
  const {{picture, map, lattice}} = explorer, found = picture.cells(map.view);
  const walking = found.all.filter(([, , label]) => label >= {pictures.FIRST_ATTRACTOR}).length;
  return [walking * lattice.cellArea(found.level), found.all.length];
}})()"""
"""The area of cells that walk, and how many cells are shown: they themselves take long to tell."""


def area_of(page):
    return page.value(WALKING)


class Held:
    """Requests of a kind that are held, and let go at will."""

    def __init__(self, page, pattern):
        self.page, self.routes = page, []
        page.page.route(pattern, lambda route: self.routes.append(route))

    def wait(self, count):
        stop = time.monotonic() + SECONDS
        while len(self.routes) < count and time.monotonic() < stop:
            self.page.page.wait_for_timeout(20)
        self.page.page.wait_for_timeout(50)
        assert len(self.routes) == count, [one.request.post_data_json for one in self.routes]

    def let_go(self):
        for route in self.routes:
            route.continue_()  # one that the page has given up goes nowhere
        self.routes.clear()
