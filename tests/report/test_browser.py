"""The page at work in a real browser, opened from a file and without a network."""

import json
import math
import os
import shutil
import threading
import zlib
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import quote, unquote, urlparse

import numpy as np
import pytest
import torch

from fovden import color
from fovden.camera import Gaze
from fovden.colormap import MAGMA
from fovden.report import write_report

webdriver = pytest.importorskip("selenium.webdriver", reason="selenium is not installed")
from page_at_work import (  # noqa: E402
    COUNTS,
    EXPOSURE,
    IMAGES,
    NAMES,
    canvas,
    expected,
    open_page,
    place,
    point_at,
    press,
    read,
    settle,
    shown,
    shows,
    text,
    until,
)
from selenium.webdriver.chrome.service import Service  # noqa: E402
from selenium.webdriver.common.action_chains import ActionChains  # noqa: E402
from selenium.webdriver.common.actions.wheel_input import ScrollOrigin  # noqa: E402
from selenium.webdriver.common.keys import Keys  # noqa: E402
from slow_decoder import bytes_of, read_page  # noqa: E402

FLAGS = (
    "--headless=new --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking "
    "--disable-component-update --disable-sync --disable-dev-shm-usage --force-device-scale-factor=1"
)


@pytest.fixture(scope="module")
def url(tmp_path_factory):
    truth = IMAGES["Reference"]
    path = tmp_path_factory.mktemp("a folder, so to say “größer”") / "the report.html"
    write_report(
        path,
        {name: image for name, image in IMAGES.items() if name != "Reference"},
        truth,
        title="<i>Title</i>",
        exposure=EXPOSURE,
        gaze=Gaze(torch.tensor([[7.0, 6.0], [5.0, 6.0]])),
        radii=(3.0,),
        samples={"Noisy": COUNTS},
        tables=None,
    )
    return path.as_uri()


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    binary, driver = shutil.which("chromium"), shutil.which("chromedriver")
    if not binary or not driver:
        pytest.skip("chromium and chromedriver are not installed (Debian: chromium, chromium-driver)")
    os.environ["SE_OFFLINE"] = "true"  # nothing may be fetched instead of the given programs
    options = webdriver.ChromeOptions()
    options.binary_location = binary
    for flag in [*FLAGS.split(), f"--user-data-dir={tmp_path_factory.mktemp('profile')}", "--window-size=1366,768"]:
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    started = webdriver.Chrome(options, Service(driver))
    yield started
    started.quit()


@pytest.fixture
def page(browser, url):
    open_page(browser, url)
    yield browser
    assert [entry for entry in browser.get_log("browser") if entry["level"] == "SEVERE"] == []


def test_it_opens_offline_and_requests_nothing(browser, url):
    browser.get_log("performance")
    open_page(browser, url)
    events = [json.loads(entry["message"])["message"] for entry in browser.get_log("performance")]
    sent = [event["params"] for event in events if event["method"] == "Network.requestWillBeSent"]
    requests = [request["request"]["url"] for request in sent if request["documentURL"] == url]  # not the start page's
    assert [request for request in requests if not request.startswith(("data:", "blob:"))] == [url]
    assert browser.get_log("browser") == []
    assert browser.title == "<i>Title</i>"
    blocked = "const done = arguments[0]; fetch('data:text/plain,x').then(() => done('let through'), () => done('no'));"
    assert browser.execute_async_script(blocked) == "no"
    assert browser.get_log("browser")[0]["message"].count("Content Security Policy") >= 1


@pytest.fixture
def served(url):
    """The page from a server that says, as many do, that all its pages are in UTF-8."""
    folder = Path(unquote(urlparse(url).path)).parent

    class Handler(SimpleHTTPRequestHandler):
        def guess_type(self, _):
            return "text/html; charset=utf-8"

        def __init__(self, *arguments):
            super().__init__(*arguments, directory=folder)

        def log_message(self, *_):
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        threading.Thread(target=server.serve_forever).start()
        yield f"http://127.0.0.1:{server.server_port}/{quote('the report.html')}"
        server.shutdown()


def test_it_is_read_rightly_from_a_server_that_names_another_encoding(browser, served):
    open_page(browser, served)
    assert shows(browser, "Noisy")
    assert "Clean & <b>bold</b>" in browser.page_source.replace("&amp;", "&").replace("&lt;", "<").replace("&gt;", ">")


def test_pixels_copied_from_another_image_are_shown(page, url):
    """With differences to predictions from copied neighbours, which is the hardest to read."""
    report, data = read_page(Path(unquote(urlparse(url).path)).read_text(encoding="utf-16"))
    reference = report["images"][2]
    assert reference["like"] == 1
    assert zlib.decompress(bytes_of(data[reference["data"]]))[0] == 1
    press(page, "r")
    assert shows(page, "Reference")


def test_keys_and_pointer_flip_between_images(page):
    assert shows(page, "Noisy")
    assert tuple(shown(page)[2, 3]) == (0, 255, 255)  # what is not a number
    for key, name in (("2", 1), (Keys.ARROW_RIGHT, 2), (Keys.ARROW_RIGHT, 0), (Keys.ARROW_LEFT, 2), ("1", 0)):
        press(page, key)
        assert shows(page, NAMES[name])
    for key in ("r", Keys.SPACE):
        press(page, "2", key)
        assert shows(page, "Reference")
        press(page, key)
        assert shows(page, NAMES[1])
    entries = page.find_elements("css selector", "#images button")
    assert [entry.find_element("css selector", ".name").text for entry in entries] == NAMES
    ActionChains(page, duration=0).move_to_element(entries[0]).perform()
    settle(page)
    assert shows(page, "Noisy")  # while the pointer is there
    ActionChains(page, duration=0).move_to_element(canvas(page)).perform()
    settle(page)
    assert shows(page, NAMES[1])
    entries[2].click()
    ActionChains(page, duration=0).move_to_element(canvas(page)).perform()
    settle(page)
    assert shows(page, "Reference")
    assert entries[2].get_attribute("aria-pressed") == "true"
    press(page, Keys.SPACE)  # the key belongs to the page, not to the button that was clicked
    assert shows(page, NAMES[1])
    page.execute_cdp_cmd("Input.dispatchMouseEvent", mouse(page, "mousePressed"))
    settle(page)
    assert shows(page, "Reference")
    page.execute_cdp_cmd("Input.dispatchMouseEvent", mouse(page, "mouseReleased"))
    settle(page)
    assert shows(page, NAMES[1])


def mouse(browser, kind):
    box = canvas(browser).rect
    middle = {"x": box["x"] + box["width"] / 2, "y": box["y"] + box["height"] / 2}
    return {"type": kind, "button": "right", "clickCount": 1, **middle}


def test_the_exposure_is_applied_to_the_linear_data(page):
    press(page, "2", *[Keys.ARROW_UP] * 8)
    assert text(page, "stops") == "+2.00 stops"
    assert shows(page, NAMES[1], 4 * EXPOSURE)
    press(page, *[Keys.ARROW_DOWN] * 14)
    assert text(page, "stops") == "\N{MINUS SIGN}1.50 stops"
    assert shows(page, NAMES[1], EXPOSURE / 2**1.5)
    page.find_element("id", "exposure").send_keys(Keys.HOME)
    settle(page)
    assert text(page, "stops") == "\N{MINUS SIGN}8.00 stops"
    page.find_element("id", "exposure-reset").click()
    settle(page)
    assert shows(page, NAMES[1])


@pytest.mark.parametrize(("x", "y", "eye"), [(4, 7, 0), (11, 0, 1), (0, 9, 1)])
def test_values_under_the_pointer_are_those_of_the_tensor(page, x, y, eye):
    press(page, "2")
    point_at(page, x, y, eye)
    assert text(page, "place").split() == [("left", "right")[eye], "eye", "x", str(x), "y", str(y)]
    for row, name in (("own", NAMES[1]), ("truth", "Reference")):
        assert text(page, f"{row}-name") == name
        values = [float(text(page, f"{row}-{channel}")) for channel in "rgb"]
        # 0.87 % of the value and of the knee, and half a unit of the third digit
        assert values == pytest.approx(IMAGES[name][eye, :, y, x].tolist(), rel=0.014, abs=0.0002)
    press(page, "1")
    assert f"samples {int(COUNTS[eye, 0, y, x])}" in text(page, "details")
    difference = color.display(IMAGES["Noisy"], EXPOSURE) - color.display(IMAGES["Reference"], EXPOSURE)
    error = float(difference[eye, :, y, x].square().mean().sqrt())
    assert float(text(page, "details").rpartition("RMSE ")[2]) == pytest.approx(error, abs=0.005)
    point_at(page, 3, 2, 0)
    assert [text(page, f"own-{channel}") for channel in "rgb"] == ["NaN"] * 3


def test_error_maps_have_the_colours_of_a_labelled_bar(page):
    assert not page.find_element("id", "bar").is_displayed()
    press(page, "2", "e")
    scale = page.execute_script("return pictures.scale('display').end")
    for factor in (1, 2):
        for eye in (0, 1):
            difference = color.display(IMAGES[NAMES[1]], EXPOSURE) - color.display(IMAGES["Reference"], EXPOSURE)
            errors = difference[eye].square().mean(0).sqrt() / (scale * factor)
            wanted = MAGMA[(255 * errors.clamp(0, 1)).round().long()].numpy().astype(int)
            assert np.abs(shown(page, eye) - wanted).max() <= 9  # the rounding moves an entry or two of the map
        if factor == 1:
            assert text(page, "bar-label") == "RMS over R, G, B of the difference of display values"
            ticks = [tick.text for tick in page.find_elements("css selector", "#bar-ticks span")]
            assert (ticks[0], len(ticks)) == ("0", 5)
            assert float(ticks[-1].removeprefix("≥ ")) == scale
            page.find_element("id", "bar-more").click()
            settle(page)
    press(page, "e")
    assert "FLIP at 67 pixels per degree" in text(page, "bar-label")
    press(page, "e")
    assert "logarithmic" in text(page, "bar-label")
    relative = (IMAGES[NAMES[1]] - IMAGES["Reference"]).square() / (IMAGES["Reference"].square() + 0.01)
    end = page.execute_script("return pictures.scale('relative').end")
    wanted = MAGMA[(255 * (1 + (relative[0].mean(0) / end).log10() / 4).clamp(0, 1)).round().long()].numpy().astype(int)
    assert np.median(np.abs(shown(page) - wanted)) <= 3
    press(page, "r")
    assert shows(page, "Reference")  # which has no error
    press(page, "e")
    assert not page.find_element("id", "bar").is_displayed()


def test_the_split_shows_two_images_and_moves(page):
    press(page, "2", "s")

    def columns_of(name):
        same = np.abs(shown(page) - expected(name)).max(-1).max(0) <= 1
        return same.nonzero()[0].tolist()

    assert (columns_of(NAMES[1]), columns_of("Reference")) == (list(range(7)), list(range(7, 14)))
    handle = page.find_element("css selector", ".handle")
    quarter = -canvas(page).size["width"] / 4
    ActionChains(page, duration=0).drag_and_drop_by_offset(handle, round(quarter), 0).perform()
    settle(page)
    assert handle.get_attribute("aria-valuenow") in ("24", "25", "26")
    assert len(columns_of("Reference")) == 14 - len(columns_of(NAMES[1])) > 7
    handle.send_keys(Keys.END, Keys.ARROW_LEFT)
    settle(page)
    assert handle.get_attribute("aria-valuenow") == "99"
    page.find_element("css selector", "#split option[value='0']").click()
    handle.send_keys(Keys.HOME)
    settle(page)
    point_at(page, 4, 4)
    assert text(page, "own-name") == "Noisy"
    press(page, "s")
    assert not handle.is_displayed()
    assert shows(page, NAMES[1])


def test_zoom_and_pan_are_linked_and_pixels_stay_squares(page):
    press(page, "2")
    dx, dy = point_at(page, 8, 3)
    origin = ScrollOrigin.from_element(canvas(page), dx, dy)
    ActionChains(page, duration=0).scroll_from_origin(origin, 0, -200).perform()
    settle(page)
    assert text(page, "place").endswith("x 8  y 3")  # what is under the pointer stays there
    size = canvas(page).size
    middle = (size["width"] // 2 + dx, size["height"] // 2 + dy)
    around = [(middle[0] + x, middle[1] + y) for x in range(-6, 7) for y in range(-6, 7)]
    for eye in (0, 1):
        colours = read(page, around, eye)
        assert (colours == colours[0]).all()  # one colour, not a gradient
        assert np.abs(colours[0] - expected(NAMES[1], eye)[3, 8]).max() <= 1
    scale, before = page.execute_script("return [stage.scale, stage.centre]")
    drag = ActionChains(page, duration=0).move_to_element_with_offset(canvas(page, 1), 0, 0).click_and_hold()
    drag.move_by_offset(-20, 10).release().perform()
    settle(page)
    after = page.execute_script("return stage.centre")
    assert after == pytest.approx([before[0] + 20 / scale, before[1] - 10 / scale])
    before = after
    ActionChains(page, duration=0).key_down(Keys.SHIFT).send_keys(Keys.ARROW_LEFT).key_up(Keys.SHIFT).perform()
    settle(page)
    after = page.execute_script("return stage.centre")
    assert after == pytest.approx([before[0] - 60 / scale, before[1]])
    ActionChains(page, duration=0).double_click(canvas(page)).perform()
    settle(page)
    assert shows(page, NAMES[1])
    press(page, "+", "+", "-")
    assert page.execute_script("return stage.scale / stage.fit") == pytest.approx(1.5)
    press(page, "0")
    assert shows(page, NAMES[1])


def test_two_fingers_zoom(page):
    box = canvas(page).rect
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    for kind, distances in (("touchStart", [20]), ("touchMove", [30, 40]), ("touchEnd", [])):
        for distance in distances or [None]:
            points = (
                [] if distance is None else [{"x": x - distance, "y": y, "id": 0}, {"x": x + distance, "y": y, "id": 1}]
            )
            page.execute_cdp_cmd("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})
    settle(page)
    assert page.execute_script("return stage.scale / stage.fit") == pytest.approx(2, rel=0.1)


def test_circles_and_gaze_go_on_and_off(page):
    def ring(eye, gaze):
        column, row, _ = place(page, gaze[0] + 3 - 0.5, gaze[1] - 0.5)
        return read(page, [(column, row)], eye)[0]

    blue = np.array([0x56, 0xB4, 0xE9])
    before = [ring(0, (7, 6)), ring(1, (5, 6))]
    press(page, "l")
    for eye, gaze in ((0, (7, 6)), (1, (5, 6))):
        assert np.abs(ring(eye, gaze) - blue).max() < 40
    press(page, "l")
    assert np.array_equal([ring(0, (7, 6)), ring(1, (5, 6))], before)


def test_tables_sort_and_copy(page):
    table = page.find_element("css selector", ".table")

    def column(number):
        return [row.text for row in table.find_elements("css selector", f"tbody td:nth-child({number})")]

    assert column(1) == [NAMES[1]]  # the other one is not finite
    page.execute_script(
        "const body = arguments[0].querySelector('tbody'), row = body.rows[0].cloneNode(true);"
        "row.cells[0].textContent = 'A, \"b\" & c_d';"
        "row.cells[2].dataset.value = '99.5'; row.cells[2].textContent = '99.50'; body.append(row);",
        table,
    )
    psnr = table.find_elements("css selector", "thead button")[2]
    psnr.click()
    assert (column(1)[0], column(3)[0]) == ('A, "b" & c_d', "99.50")  # the best first
    psnr.click()
    assert column(1)[0] == NAMES[1]
    assert psnr.find_element("xpath", "..").get_attribute("aria-sort") == "ascending"
    table.find_elements("css selector", "thead button")[0].click()
    assert column(1) == ['A, "b" & c_d', NAMES[1]]
    table.find_element("css selector", "[data-copy=csv]").click()
    lines = pasted(page).splitlines()
    assert lines[0].startswith("method,RMSE,PSNR / dB,SSIM" if len(lines[0].split(",")) > 3 else "method,")
    assert lines[1].startswith('"A, ""b"" & c_d",')
    values = [float(value) for value in lines[2].split(",")[1:]]
    assert values[0] == pytest.approx(float(column(2)[1]), abs=1e-4)
    assert len(lines[2].split(",")[1]) > 8  # in full
    table.find_element("css selector", "[data-copy=latex]").click()
    latex = pasted(page)
    assert latex.startswith("\\begin{tabular}{lrr")
    assert "\\toprule" in latex
    assert 'A, "b" \\& c\\_d & ' in latex
    assert "& 99.50 &" in latex


def pasted(browser):
    """What a paste would give."""
    until(lambda: "copied" in browser.find_element("css selector", ".table [role=status]").text)
    script = (
        "const area = document.createElement('textarea'); area.id = 'paste'; document.body.append(area); area.focus();"
    )
    browser.execute_script(script)
    area = browser.find_element("id", "paste")
    area.send_keys(Keys.CONTROL, "v")
    value = area.get_attribute("value")
    browser.execute_script("arguments[0].remove()", area)
    return value


def test_every_control_is_reached_by_tab(page):
    reached = []
    for _ in range(40):
        ActionChains(page, duration=0).send_keys(Keys.TAB).perform()
        reached.append(
            page.execute_script(
                "const e = document.activeElement;"
                "const name = e.id || e.name || e.dataset.copy || e.textContent.slice(0, 30);"
                "return [name, getComputedStyle(e).outlineStyle];"
            )
        )
    names = [name for name, _ in reached]
    for name in ("zoom-in", "mode", "split", "eyes", "circles", "exposure", "csv", "latex"):
        assert name in names, names
    assert sum(any(image in name for image in ("Noisy", "Clean", "Reference")) for name in names) >= 3
    assert {style for name, style in reached if name in ("split", "csv", "zoom-in")} == {"solid"}


@pytest.mark.parametrize("size", [(1366, 768), (3840, 2160), (800, 1000)])
def test_it_fits_the_screen(page, size):
    width, height = size
    metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
    page.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
    try:
        settle(page)
        assert page.execute_script("return document.documentElement.scrollWidth") <= width
        box = page.find_element("id", "stage").rect
        assert box["y"] + box["height"] < height
        assert box["height"] > 0.4 * height
        assert float(page.find_element("tag name", "body").value_of_css_property("font-size")[:-2]) >= 13
    finally:
        page.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


def test_pages_of_odd_images_open(browser, tmp_path):
    nothing, black = torch.full((1, 3, 6, 8), math.nan), torch.zeros(1, 3, 6, 8)
    hostile = "</script><script>alert(1)</script>"
    cases = {
        "broken": ({hostile: nothing}, nothing),
        "black": ({"black": black}, black),
        "alone": ({"black": black}, None),
    }
    for name, (images, truth) in cases.items():
        path = write_report(tmp_path / f"{name}.html", images, truth, title=hostile)
        open_page(browser, path.as_uri())
        for key in ("e", "e", "s", "r", "l", Keys.ARROW_RIGHT):
            press(browser, key)
        assert [entry for entry in browser.get_log("browser") if entry["level"] == "SEVERE"] == [], name
        assert not browser.find_element("id", "failure").is_displayed()
        assert browser.title == hostile
    assert "There is no reference" in browser.find_element("tag name", "footer").text
