"""What is in the page, without a browser; and bad input."""

import json
import math
import re
import shutil
from html.parser import HTMLParser
from importlib import import_module

import numpy as np
import pytest
import torch
from slow_decoder import bytes_of, images_of, map_of, read_page

from fovden import color, metrics
from fovden.camera import Gaze
from fovden.checks import ShapeError
from fovden.comparison import CompareSettings, SceneSettings, compare_denoisers, read_comparison
from fovden.frame import Reference
from fovden.io import save_image
from fovden.report import Column, Table, quality_tables, report_comparison, write_report
from fovden.report.scales import error_scales

SHAPE = (2, 3, 14, 12)
NASTY = "</script><script>alert(1)</script><img src=x onerror=alert(2)> & \"quoted\" 'too' {{ 7 * 7 }} \u2028 <!--"


def picture(seed, scale=1.0):
    return torch.rand(SHAPE, generator=torch.Generator().manual_seed(seed)) * scale


class Elements(HTMLParser):
    """Tags, with their attributes, in the order of the page, and the text of each title."""

    def __init__(self, text):
        super().__init__()
        self.found = []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.found.append((tag, dict(attributes)))

    def all(self, tag):
        return [attributes for name, attributes in self.found if name == tag]


def read(path):
    return path.read_text(encoding="utf-16")


@pytest.fixture
def page(tmp_path):
    return tmp_path / "report.html"


def test_images_reference_and_maps_are_those_given(page):
    truth, counts = picture(0), torch.arange(2 * 14 * 12).reshape(2, 1, 14, 12) % 7
    images = {"first": picture(1), "second": picture(2, 4.0)}
    options = {"layer": counts // 3, "samples": {"second": counts}, "exposure": 0.8}
    assert (
        write_report(page, images, truth, gaze=Gaze(torch.tensor([[5.0, 6.0], [4.5, 6.0]])), radii=(2, 4.5), **options)
        == page
    )
    report, data = read_page(read(page))
    assert [image["name"] for image in report["images"]] == ["first", "second", "Reference"]
    assert (report["reference"], report["exposure"], report["eyes"]) == (2, 0.8, ["left eye", "right eye"])
    assert (report["gaze"], report["radii"]) == ([[5.0, 6.0], [4.5, 6.0]], [2.0, 4.5])
    for values, image in zip(images_of(report, data), [*images.values(), truth], strict=True):
        assert np.abs(values - image.numpy()).max() < 0.009 * (4 + report["knee"])
    assert np.array_equal(map_of(bytes_of(data[report["layer"]]), counts.shape), counts // 3)
    assert np.array_equal(map_of(bytes_of(data[report["images"][1]["samples"]]), counts.shape), counts)
    assert report["images"][0]["samples"] is None
    expected = metrics.flip_map(color.display(images["first"], 0.8), color.display(truth, 0.8))
    levels = map_of(bytes_of(data[report["images"][0]["flip"]]), counts.shape)
    assert np.abs(levels / report["flip_levels"] - expected.numpy()).max() <= 0.5 / report["flip_levels"] + 1e-6


def test_pixels_of_an_earlier_image_are_stored_once(page):
    first, second = picture(1), picture(2)
    changed = torch.where(torch.arange(12) < 7, first, second)
    images = {"first": first, "second": second, "changed": changed, "the same": first}
    write_report(page, images)
    report, data = read_page(read(page))
    assert [entry["like"] for entry in report["images"]] == [None, None, 0, 0]
    sizes = [len(data[entry["data"]]) for entry in report["images"]]
    assert sizes[2] < 0.6 * sizes[0]
    assert sizes[3] < 10
    for values, image in zip(images_of(report, data), images.values(), strict=True):
        assert np.abs(values - image.numpy()).max() < 0.009 * (1 + report["knee"])


def test_a_page_that_would_be_too_large_has_coarser_steps_and_says_so(page):
    images, sizes = {"noise": picture(1)}, [40e6]
    for steps, stated in ((40, "0.87 %"), (28, "1.25 %"), (20, "1.75 %")):
        write_report(page, images, size_limit=sizes[-1] - 20)
        report, data = read_page(read(page))
        assert report["steps"] == steps
        assert f"to within {stated}" in read(page)
        (values,) = images_of(report, data)
        bound = (2 ** (0.5 / steps) - 1) * (images["noise"].numpy() + report["knee"])
        assert (np.abs(values - images["noise"].numpy()) <= bound * (1 + 1e-9)).all()
        sizes.append(2 * len(data[report["images"][0]["data"]]))
    assert sizes == sorted(sizes, reverse=True)


def test_nothing_in_the_page_can_ask_for_anything(page):
    write_report(page, {"image": picture(1)}, picture(0))
    elements = Elements(read(page))
    policy = next(meta["content"] for meta in elements.all("meta") if "http-equiv" in meta)
    assert policy.startswith("default-src 'none';")
    assert "http" not in policy
    for tag, attributes in elements.found:
        for name, value in attributes.items():
            assert name not in ("src", "srcset", "action", "formaction", "data", "poster"), tag
            assert name != "href" or value == "data:,", tag
    page_without_namespaces = read(page)
    assert not re.findall(
        r"\b(?:https?:)?//[\w-]+\.\w+|@import|url\(|\bfetch\(|XMLHttpRequest|WebSocket", page_without_namespaces
    )


def test_markup_in_every_text_stays_text(page):
    plain = Elements(write_and_read(page, "plain"))
    nasty_text = write_and_read(page, NASTY)
    nasty = Elements(nasty_text)
    assert [tag for tag, _ in nasty.found] == [tag for tag, _ in plain.found]
    assert "alert(1)</script>" not in nasty_text
    assert "49" not in re.search(r"<title>(.*?)</title>", nasty_text)[1]
    report, _ = read_page(nasty_text)
    assert report["images"][0]["name"] == NASTY
    assert report["images"][0]["caption"] == NASTY


def write_and_read(page, text):
    write_report(
        page,
        {text: torch.ones(1, 3, 2, 2)},
        title=text,
        subtitle=text,
        captions={text: text},
        tables=[Table(text, (Column(text), Column("value", ".2f")), ((text, 1.0),), text)],
        notes=[text],
        provenance={text: {text: [text, 1]}},
    )
    return read(page)


def test_odd_paths_and_names(tmp_path):
    folder = tmp_path / 'Über uns, 日本 "x" & <b>'
    folder.mkdir()
    path = write_report(folder / "re port é.html", {"Bild à 1": picture(1)}, title="tête-à-tête\udc80")
    assert "<title>tête-à-tête?</title>" in read(path)
    assert [entry.name for entry in folder.iterdir()] == ["re port é.html"]


def test_without_a_reference_the_page_says_so(page):
    write_report(page, {"one": picture(1), "Reference": picture(2)})
    text = read(page)
    report, _ = read_page(text)
    assert report["reference"] is None
    assert report["scales"] == []
    assert "There is no reference, and so there are no error maps." in text
    assert "<table" not in text
    assert 'value="error"' not in text


@pytest.mark.parametrize("value", [0.0, math.nan, math.inf, -1.0])
@pytest.mark.parametrize("where", ["image", "reference", "both"])
def test_black_and_broken_images_make_a_page(page, value, where):
    odd, sound = torch.full(SHAPE, value), picture(1)
    image, truth = {"image": (odd, sound), "reference": (sound, odd), "both": (odd, odd)}[where]
    write_report(page, {"image": image, "sound": sound}, truth)
    report, data = read_page(read(page))
    stored = images_of(report, data)[0]
    assert np.allclose(stored, image.numpy(), rtol=0.02, atol=0.01, equal_nan=True)
    assert report["exposure"] > 0
    assert all(0 < scale["end"] < math.inf for scale in report["scales"])
    tables = "<table>" in read(page)
    assert tables == bool(truth.isfinite().all())
    row = "<td>image</td>" in read(page)
    assert row == (tables and bool(image.isfinite().all()))
    json.dumps(report, allow_nan=False)


def test_the_scores_are_those_of_the_metrics(page):
    truth, images = picture(0), {"first": picture(1), "second": picture(2)}
    write_report(page, images, Reference(truth, torch.full_like(truth, 1e-3), 16), exposure=1.0)
    scores = metrics.compare(images, Reference(truth, torch.full_like(truth, 1e-3), 16), exposure=1.0)
    text = read(page)
    for name in images:
        for metric in ("psnr", "flip", "relative_mse"):
            assert f'data-value="{scores.value(name, metric)!r}"' in text
        assert f"{scores.value(name, 'psnr'):.2f} dB, SSIM {scores.value(name, 'ssim'):.3f}" in text


def test_tables_mark_what_is_best_as_it_is_shown():
    columns = (Column("method"), Column("PSNR", ".1f", "higher"), Column("RMSE", ".2f", "lower"), Column("n", ".0f"))
    rows = (("a", 30.01, 0.2, 1), ("b", 30.04, 0.1, 2), ("c", math.nan, None, 3))
    cells = Table("t", columns, rows).cells()
    assert [cell.classes for cell in cells[0]] == ["", "number best", "number", "number"]
    assert [cell.classes for cell in cells[1]] == ["", "number best", "number best", "number"]
    assert [cell.text for cell in cells[2]] == ["c", "nan", "", "3"]
    infinite = Table("t", columns[:2], (("a", math.inf), ("b", 1.0))).cells()[0][1]
    assert infinite == ("∞", "Infinity", "number best")
    with pytest.raises(ValueError, match=r"rows\[0\]: expected 1 values"):
        Table("t", columns[:1], (("a", 1.0),))


def test_tables_by_layer_and_eye_hold_the_scores():
    truth = torch.rand(2, 3, 16, 16, generator=torch.Generator().manual_seed(0))
    layer = (torch.arange(16) // 6).expand(2, 1, 16, 16)
    scores = metrics.compare({"half": truth / 2}, truth, layer=layer)
    whole, layers, eyes = quality_tables(scores.scores, eyes=("left eye", "right eye"))
    assert whole.rows[0][1:] == tuple(scores.value("half", metric) for metric in scores.metrics)
    titles = [column.title for column in layers.columns]
    assert layers.rows[0][titles.index("PSNR / dB, layer 2")] == pytest.approx(scores.value("half", "psnr", "layer 2"))
    titles = [column.title for column in eyes.columns]
    assert eyes.rows[0][titles.index("PSNR / dB, right eye")] == scores.value("half", "psnr", view=1)
    assert len(quality_tables([s for s in scores.scores if s.region == "whole"], eyes=("image",))) == 1


def test_scales_cover_most_of_the_errors():
    truth, errors = torch.full((1, 3, 50, 50), 0.5), torch.linspace(0, 0.5, 2500).reshape(1, 1, 50, 50)
    display, relative = error_scales({"image": truth + errors, "Reference": truth}, truth, 1.0, None)
    shown = (color.display(truth + errors, 1.0) - color.display(truth, 1.0)).flatten()
    assert float(shown.quantile(0.97)) < display["end"] < 1.5 * float(shown.max())
    assert relative["end"] == 1.0
    (only,) = [scale for scale in error_scales({"Reference": truth}, truth, 1.0, 67.0) if scale["name"] == "flip"]
    assert only["end"] == 1.0


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"images": {}}, ValueError, "images: expected at least one image"),
        (
            {"images": {"a": picture(1), "b": torch.zeros(2, 3, 5, 4)}},
            ShapeError,
            r"images\['b'\]: expected the size of images\['a'\], 2 views of 12 x 14 pixels, got 2 views of 4 x 5",
        ),
        (
            {"reference": torch.zeros(1, 3, 14, 12)},
            ShapeError,
            r"reference: expected the size of images\['a'\], 2 views .* got 1 views",
        ),
        ({"images": {"a": picture(1)[0]}}, ShapeError, r"images\['a'\]: expected shape"),
        ({"images": {"a": picture(1).numpy()}}, TypeError, r"images\['a'\]: expected a tensor, got ndarray"),
        ({"images": {"a": torch.zeros(1, 3, 0, 4)}, "reference": None}, ValueError, "at least one pixel"),
        ({"images": {"Reference": picture(1)}}, ValueError, "another name, as that is taken"),
        ({"exposure": 0}, ValueError, "exposure: expected a finite number, above 0"),
        ({"samples": {"c": picture(1)[:, :1]}}, ValueError, r"samples: expected names of the images, got \['c'\]"),
        ({"samples": {"a": picture(1)[:, :, :3]}}, ShapeError, r"samples\['a'\]: expected shape"),
        ({"layer": torch.zeros(2, 1, 3, 3)}, ShapeError, "layer: expected shape"),
        ({"radii": (3.0,)}, ValueError, "radii: expected none without a gaze"),
        ({"gaze": Gaze(torch.zeros(1, 2))}, ShapeError, "gaze.pixels: expected shape"),
        (
            {"gaze": Gaze(torch.zeros(2, 2)), "radii": (0,)},
            ValueError,
            r"radii\[0\]: expected a finite number, above 0",
        ),
    ],
)
def test_bad_arguments_are_named(page, change, error, message):
    arguments = {"images": {"a": picture(1)}, "reference": picture(0), "tables": [], **change}
    with pytest.raises(error, match=message):
        write_report(page, **arguments)
    assert not list(page.parent.iterdir())


def test_a_page_that_cannot_be_written_leaves_nothing(page, monkeypatch):
    with pytest.raises(FileNotFoundError, match=r"nowhere/a\.html: the folder .* does not exist"):
        write_report(page.parent / "nowhere" / "a.html", {"a": picture(1)})
    with pytest.raises(IsADirectoryError, match="cannot be written"):
        write_report(page.parent, {"a": picture(1)})
    page.write_text("the old page")
    module = import_module("fovden.report.page")

    def full(self, data):
        self.write_text(repr(data[:9]))
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("pathlib.Path.write_bytes", full)
    with pytest.raises(OSError, match=r"report\.html: cannot be written \(No space left on device\)"):
        write_report(page, {"a": picture(1)})
    monkeypatch.undo()
    monkeypatch.setattr(module.os, "access", lambda *_: False)
    with pytest.raises(PermissionError, match="cannot be written to"):
        write_report(page, {"a": picture(1)})
    assert [entry.name for entry in page.parent.iterdir()] == ["report.html"]
    assert page.read_text() == "the old page"


# The report of a comparison


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("comparison")
    view = SceneSettings("cornell_box", resolution=(20, 16))
    compare_denoisers(CompareSettings(view, reference_spp=2, repeats=1, seed=5), folder, progress=False)
    return folder


def test_a_comparison_is_reported_from_its_folder(folder):
    path = report_comparison(folder)
    assert path == folder / "report.html"
    text = read(path)
    report, data = read_page(text)
    saved = read_comparison(folder)
    assert [image["name"] for image in report["images"]] == [*saved.images, "Reference"]
    assert report["exposure"] == saved.exposure
    assert tuple(report["radii"]) == saved.radii
    nh3ld = report["images"][5]
    values = images_of(report, data)[5]
    image = saved.images["NH3LD"].numpy()
    assert (np.abs(values - image) <= 0.0088 * (image + report["knee"])).all()
    counts = map_of(bytes_of(data[nh3ld["samples"]]), (2, 1, 20, 16))
    assert np.array_equal(counts, saved.foveated.counts.numpy())
    for title in ("Quality, mean of the eyes", "Quality by layer", "Quality by eye", "Cost", "Provenance"):
        assert f"<h2>{title}</h2>" in text
    foot = dict(re.findall(r"<dt>(.*?)</dt><dd>(.*?)</dd>", text, re.DOTALL))
    assert foot["seed"] == "5"
    assert f"torch {torch.__version__}" in foot["versions"]
    assert foot["device"]
    assert "16, 20" not in foot["view"]
    assert "resolution 20, 16" in foot["view"]
    assert "commit" in foot or saved.provenance["commit"] is None
    assert str(folder) not in text
    assert path.read_bytes() == report_comparison(folder).read_bytes()


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda folder: (folder / "metrics.csv").unlink(), "metrics.csv: no such file"),
        (lambda folder: (folder / "reference.exr").unlink(), "reference.exr: no such file"),
        (lambda folder: (folder / "images" / "base.exr").write_bytes(b"x"), r"base\.exr: "),
        (lambda folder: (folder / "config.json").write_text("{"), "config.json: expected JSON"),
        (lambda folder: (folder / "provenance.json").write_text("[1]"), "provenance.json: expected a mapping"),
        (lambda folder: (folder / "provenance.json").unlink(), "provenance.json: no such file"),
        (
            lambda folder: save_image(folder / "images" / "nh2ld.exr", torch.ones(2, 3, 8, 8)),
            r"images\['NH2LD'\]: expected the size of images\['Noisy, full'\], 2 .* 16 x 20 .* got 2 .* 8 x 8 ",
        ),
    ],
)
def test_a_damaged_folder_is_one_error_that_names_the_file(folder, tmp_path, damage, message):
    copy = tmp_path / "copy"
    shutil.copytree(folder, copy, ignore=shutil.ignore_patterns("report.html"))
    damage(copy)
    with pytest.raises((OSError, ValueError), match=message):
        report_comparison(copy)
    assert not (copy / "report.html").exists()
