"""Fixtures of more than one file."""

import os

import explorer_server
import pytest
from explorer_page import CHROMIUM, OWN, REQUIRED, Page, Spiral

from walker_jax.explorer.offers import FAMILY, OTHERS, offer


@pytest.fixture(scope="module")
def page_server():
    with explorer_server.running(offers=FAMILY | {"Own": OWN}) as server:
        yield server


@pytest.fixture(scope="module")
def machines():
    with explorer_server.running(offers=OTHERS | {"Spiral": offer(Spiral())}) as server:
        yield server


@pytest.fixture(scope="module")
def browser():
    if CHROMIUM is None:
        reason = "the page is tested in Chromium, which is not installed: apt-get install chromium"
        if os.environ.get(REQUIRED):
            pytest.fail(reason)
        pytest.skip(reason)
    from playwright.sync_api import sync_playwright  # not of the extra [test]

    with sync_playwright() as playwright:
        # --no-sandbox: Chromium refuses to run as root, as in a container, with it
        found = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield found
        found.close()


def open_pages(browser, server):
    """Opens pages of a server, and closes them in the end."""
    pages = []

    def open_page(state="", **options):
        pages.append(Page(browser, server.port, state, **options))
        return pages[-1]

    yield open_page
    for one in pages:
        one.close()


@pytest.fixture
def opened(browser, page_server):
    yield from open_pages(browser, page_server)


@pytest.fixture
def opened_system(browser, machines):
    yield from open_pages(browser, machines)


@pytest.fixture(scope="module")
def running():
    with explorer_server.running() as server:
        yield server


@pytest.fixture
def client(running):
    return running.client()
