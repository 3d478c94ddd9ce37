"""The page that the browser's tests look at, and the hands and eyes with which they do."""

import math
import time

import numpy as np
import torch
from selenium.webdriver.common.action_chains import ActionChains

from fovden import color

HEIGHT, WIDTH, EXPOSURE = 12, 14, 0.8
NAMES = ["Noisy", "Clean & <b>bold</b>", "Reference"]


def radiance(seed):
    generator = torch.Generator().manual_seed(seed)
    return torch.rand(2, 3, HEIGHT, WIDTH, generator=generator).pow(3) * 4


SMOOTH = 2 + torch.linspace(0, 2, 2 * 3 * HEIGHT * WIDTH).reshape(2, 3, HEIGHT, WIDTH)
SHARED = torch.arange(HEIGHT)[:, None] < 2 + torch.arange(WIDTH) % 2
"""Pixels that the reference copies from the image before it; the others are stored as differences."""

IMAGES = dict(zip(NAMES, (radiance(1), radiance(2), SMOOTH), strict=True))
IMAGES["Reference"][:, :, SHARED] = IMAGES["Clean & <b>bold</b>"][:, :, SHARED]
IMAGES["Noisy"][0, :, 2, 3] = math.nan
IMAGES["Noisy"][1, 0, 0, 0] = -0.5
COUNTS = torch.arange(2 * HEIGHT * WIDTH).reshape(2, 1, HEIGHT, WIDTH) % 5


def open_page(browser, url):
    browser.get(url)
    until(lambda: browser.execute_script("return document.body.dataset.loaded") == "all")
    settle(browser)


def until(condition, seconds=20.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "the page does not do it"
        time.sleep(0.02)


def settle(browser):
    """Waits until what was asked for is drawn."""
    browser.execute_async_script("const done = arguments[0]; requestAnimationFrame(() => requestAnimationFrame(done));")
    until(lambda: browser.find_element("id", "stage").get_attribute("aria-busy") == "false")


def press(browser, *keys):
    for key in keys:
        ActionChains(browser, duration=0).send_keys(key).perform()
    settle(browser)


def canvas(browser, eye=0):
    return browser.find_elements("css selector", ".pane canvas")[eye]


READ = """
const [canvas, places] = arguments;
const data = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
return places.map(([x, y]) => Array.from(data.slice(4 * (y * canvas.width + x), 4 * (y * canvas.width + x) + 3)));
"""


def read(browser, places, eye=0):
    """The colours of a canvas at some places (x, y), shape (n, 3)."""
    whole = [[int(x), int(y)] for x, y in places]
    return np.array(browser.execute_script(READ, canvas(browser, eye), whole), np.int64)


def place(browser, x, y):
    """Where the centre of pixel (x, y) is in a pane, while the image fits it, and how large a pixel is."""
    size = canvas(browser).size
    scale = min(size["width"] / WIDTH, size["height"] / HEIGHT)
    return size["width"] / 2 + (x + 0.5 - WIDTH / 2) * scale, size["height"] / 2 + (y + 0.5 - HEIGHT / 2) * scale, scale


def shown(browser, eye=0):
    """The colour near the middle of every pixel of the image, shape (h, w, 3)."""
    column, row, scale = place(browser, 0, 0)
    places = [(column + 2 + x * scale, row + y * scale) for y in range(HEIGHT) for x in range(WIDTH)]
    return read(browser, places, eye).reshape(HEIGHT, WIDTH, 3)


def expected(name, eye=0, exposure=EXPOSURE):
    return np.floor(255 * color.display(IMAGES[name].double(), exposure)[eye].permute(1, 2, 0).numpy() + 0.5)


def shows(browser, name, exposure=EXPOSURE):
    for eye in (0, 1):
        wanted = expected(name, eye, exposure)
        sound = np.isfinite(wanted).all(-1)
        if np.abs(shown(browser, eye) - wanted)[sound].max() > 1:
            return False
    return True


def point_at(browser, x, y, eye=0):
    """Moves the pointer to a pixel, and returns its distance from the middle of the pane."""
    element = canvas(browser, eye)
    column, row, _ = place(browser, x, y)
    dx, dy = round(column - element.size["width"] / 2) + 2, round(row - element.size["height"] / 2)
    ActionChains(browser, duration=0).move_to_element_with_offset(element, dx, dy).perform()
    settle(browser)
    return dx, dy


def text(browser, name):
    return browser.find_element("id", name).text
