"""Material libraries and images: exact numbers, where a texel lands, and every way to lose an image."""

import io

import numpy as np
import pytest
import torch
from PIL import Image

from fovden.tracer.formats.scene_file import SceneFileError, read_texture, texture_of
from fovden.tracer.meshes import load_scene

FACES = "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl m\nf 1/1 2/2 3/3\n"


def load(folder, mtl):
    (folder / "a.obj").write_text(FACES)
    (folder / "a.mtl").write_text("newmtl m\n" + mtl)
    return load_scene(folder / "a.obj")


def picture(path, mode="RGB", colour=(255, 0, 0), size=(2, 3)):
    Image.new(mode, size, colour).save(path)


def test_colours_are_exact_floats(tmp_path):
    materials = load(tmp_path, "Kd 0.57007 0.043014 0.044371\nKe 18.387 10.9873 2.75357 # lamp\n").materials
    assert materials.albedo.tolist() == torch.tensor([[0.57007, 0.043014, 0.044371]]).tolist()
    assert materials.emission.tolist() == torch.tensor([[18.387, 10.9873, 2.75357]]).tolist()
    assert materials.texture.tolist() == [-1]


def test_one_number_is_grey_and_keywords_ignore_case(tmp_path):
    materials = load(tmp_path, "KD 0.25\nKe 3\nNs 10\nillum 2\nmap_Bump lost.png\nmap_Ks lost.png\n").materials
    assert materials.albedo.tolist() == [[0.25, 0.25, 0.25]]
    assert materials.emission.tolist() == [[3, 3, 3]]


def test_a_plain_material_without_kd_is_half_grey(tmp_path):
    assert load(tmp_path, "Ke 1 1 1\n").materials.albedo.tolist() == [[0.5, 0.5, 0.5]]


def test_kd_multiplies_the_image_and_is_one_where_it_is_missing(tmp_path):
    picture(tmp_path / "red.png")
    materials = load(tmp_path, "Kd 0.588 0.5 0.25\nmap_Kd red.png\n").materials
    assert materials.albedo.tolist() == torch.tensor([[0.588, 0.5, 0.25]]).tolist()
    assert materials.texture.tolist() == [0]
    assert materials.textures[0].tolist() == [[[255, 0, 0]] * 2] * 3
    assert load(tmp_path, "map_Kd red.png\n").materials.albedo.tolist() == [[1, 1, 1]]


def test_the_image_has_its_top_row_first_and_uv_zero_is_its_lower_left(tmp_path):
    top, bottom = [[255, 0, 0], [0, 255, 0]], [[0, 0, 255], [255, 255, 0]]
    Image.fromarray(np.array([top, bottom], dtype=np.uint8)).save(tmp_path / "four.png")
    scene = load(tmp_path, "map_Kd four.png\n")
    image = scene.materials.textures[0]
    height, width, _ = image.shape
    texels = []
    for u, v in scene.uv.tolist():  # the nearest texel, v upwards from the last row
        texels.append(image[min(int((1 - v) * height), height - 1), min(int(u * width), width - 1)].tolist())
    assert texels == [[0, 0, 255], [255, 255, 0], [255, 0, 0]]  # lower left, lower right, upper left


def test_each_image_is_decoded_once(tmp_path):
    picture(tmp_path / "red.png")
    text = FACES + "usemtl n\nf 1/1 2/2 3/3\nusemtl o\nf 1/1 2/2 3/3\n"
    (tmp_path / "a.obj").write_text(text)
    (tmp_path / "a.mtl").write_text("newmtl m\nmap_Kd red.png\nnewmtl n\nmap_Kd ./red.png\nnewmtl o\n")
    materials = load_scene(tmp_path / "a.obj").materials
    assert materials.texture.tolist() == [0, 0, -1]
    assert len(materials.textures) == 1


@pytest.mark.parametrize(
    "name", ["my red.png", "a\\b.png", "-s 1 1 1 red.png", "-o 0 0 -mm 0 1 -clamp off -bm 1 red.png"]
)
def test_names_with_spaces_backslashes_and_neutral_options(tmp_path, name):
    (tmp_path / "a").mkdir()
    for file in ("my red.png", "a/b.png", "red.png"):
        picture(tmp_path / file)
    assert len(load(tmp_path, f"map_Kd {name}\n").materials.textures) == 1


@pytest.mark.parametrize("option", ["-s 2 2 1", "-o 0.5", "-t 0 1", "-clamp on", "-mm 0.1 1", "-cc on"])
def test_options_that_change_the_picture_warn(tmp_path, option):
    picture(tmp_path / "red.png")
    with pytest.warns(UserWarning, match=rf"a\.mtl:2: material 'm', map_kd: the option '{option}' is ignored"):
        assert len(load(tmp_path, f"map_Kd {option} red.png\n").materials.textures) == 1


def test_an_emissive_image_warns(tmp_path):
    with pytest.warns(UserWarning, match=r"a\.mtl:3: material 'm', map_ke: the image is not used"):
        assert load(tmp_path, "Ke 1 2 3\nmap_Ke red.png\n").materials.emission.tolist() == [[1, 2, 3]]


def test_a_textured_face_without_texture_coordinates_warns(tmp_path):
    picture(tmp_path / "red.png")
    (tmp_path / "a.obj").write_text(FACES + "f 1 2 3\nf 1 3 2\n")
    (tmp_path / "a.mtl").write_text("newmtl m\nmap_Kd red.png\n")
    with pytest.warns(UserWarning, match="2 faces of the textured material 'm' have no texture coordinates"):
        scene = load_scene(tmp_path / "a.obj")
    assert scene.uv[scene.faces[1]].tolist() == [[0, 0], [0, 0], [0, 0]]


@pytest.mark.parametrize(
    ("mtl", "message"),
    [
        ("Kd 0.5 0.5\n", r"a\.mtl:2: material 'm', kd: expected one or three numbers from 0 to 1, got '0\.5 0\.5'"),
        ("Kd spectral file.rfl 1\n", "kd: expected one or three numbers"),
        ("Kd 1.5 0 0\n", "from 0 to 1, got '1.5 0 0'"),
        ("Kd -0.5 0 0\n", "from 0 to 1"),
        ("Kd nan 0 0\n", "from 0 to 1"),
        ("\nKe -1 0 0\n", r"a\.mtl:3: material 'm', ke: .* at least 0"),
        ("Ke inf 0 0\n", "at least 0"),
        ("Kd\n", "got ''"),
        ("map_Kd\n", "names no file"),
        ("map_Kd -s 1 1 1\n", "names no file"),
        ("map_Kd -wrong 1 red.png\n", "unknown option '-wrong'"),
        ("map_Kd a.obj\n", r"a\.mtl:2: material 'm', map_kd: .*a\.obj: this image cannot be decoded"),
    ],
)
def test_each_fault_is_one_clear_error(tmp_path, mtl, message):
    with pytest.raises(SceneFileError, match=message):
        load(tmp_path, mtl)


def test_an_image_that_is_not_there_names_file_line_and_material(tmp_path):
    message = r"a\.mtl:3: material 'm', map_kd: the image 'tex/lost\.png' is not there"
    with pytest.raises(FileNotFoundError, match=message):
        load(tmp_path, "Kd 1 1 1\nmap_Kd tex/lost.png\n")
    with pytest.raises(FileNotFoundError, match="is not there"):
        load(tmp_path, f"map_Kd {'x' * 5000}\n")
    (tmp_path / "tex").mkdir()
    with pytest.raises(FileNotFoundError, match="is not there"):  # a folder is no image
        load(tmp_path, "map_Kd tex\n")


def test_a_truncated_image_is_one_clear_error(tmp_path):
    noise = np.random.default_rng(0).integers(0, 256, (32, 32, 3), dtype=np.uint8)
    for name in ("a.png", "a.jpg"):
        stream = io.BytesIO()
        Image.fromarray(noise).save(stream, format="JPEG" if name.endswith("jpg") else "PNG")
        data = stream.getvalue()
        for length in (0, 1, 10, 40, len(data) // 2):
            (tmp_path / name).write_bytes(data[:length])
            with pytest.raises(SceneFileError, match=f"{name}: this image cannot be decoded"):
                read_texture(tmp_path / name)


@pytest.mark.parametrize(
    ("mode", "value", "expected"),
    [
        ("1", 1, [255, 255, 255]),
        ("L", 77, [77, 77, 77]),
        ("LA", (77, 3), [77, 77, 77]),
        ("RGB", (1, 2, 3), [1, 2, 3]),
        ("RGBA", (1, 2, 3, 0), [1, 2, 3]),
        ("I;16", 65535, [255, 255, 255]),
        ("I;16", 257, [1, 1, 1]),
        ("I;16", 128, [0, 0, 0]),  # 128 / 257 rounds to 0
        ("I;16", 129, [1, 1, 1]),
        ("I", 65535, [255, 255, 255]),
    ],
)
def test_every_mode_gives_three_channels_of_eight_bits(mode, value, expected):
    texture = texture_of(Image.new(mode, (2, 1), value))
    assert texture.dtype == torch.uint8
    assert texture.tolist() == [[expected, expected]]


def test_palettes_are_looked_up_also_with_transparency(tmp_path):
    image = Image.new("P", (2, 1))
    image.putpalette([10, 20, 30, 40, 50, 60] + [0] * 762)
    image.putpixel((1, 0), 1)
    image.save(tmp_path / "plain.png")
    image.save(tmp_path / "clear.png", transparency=b"\x00\x80")
    for name in ("plain.png", "clear.png"):
        assert read_texture(tmp_path / name).tolist() == [[[10, 20, 30], [40, 50, 60]]]


@pytest.mark.parametrize(("mode", "value"), [("F", 0.5), ("I", 70000), ("I", -1)])
def test_other_number_formats_are_refused(mode, value):
    with pytest.raises(ValueError, match="the pixels are"):
        texture_of(Image.new(mode, (1, 1), value))
