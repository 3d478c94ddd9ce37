"""Models, roughness, metal and cut-outs in scene files: read from files made by hand, and written and read again."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from export_files import glb_chunks, mtl_materials
from PIL import Image
from shapes import rectangle, scene_of
from test_gltf import Builder, png

from fovden.tracer import Material, load_scene
from fovden.tracer.formats.scene_file import SceneFileError
from fovden.tracer.materials import MODELS

CUT = [[[255, 0, 0, 255], [0, 255, 0, 10]], [[0, 0, 255, 200], [255, 255, 0, 128]]]
UV = [[0, 0], [1, 0], [0, 1]]


def gltf(tmp_path, pixels=None, factors=None, material=None, **surface):
    """A triangle of one material, its images inside the file."""
    builder = Builder()
    found = [image for image in (pixels, factors) if image is not None]
    builder.json["images"] = [{"bufferView": builder.view(png(image)), "mimeType": "image/png"} for image in found]
    builder.json["textures"] = [{"source": i} for i in range(len(found))]
    if pixels is not None:
        surface["baseColorTexture"] = {"index": 0}
    if factors is not None:
        surface["metallicRoughnessTexture"] = {"index": len(found) - 1} | surface.get("metallicRoughnessTexture", {})
    builder.json["materials"] = [{"pbrMetallicRoughness": surface} | (material or {})]
    return builder.primitive(material=0, uv=UV).glb(tmp_path / "a.glb")


def mtl(folder, text):
    faces = "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl m\nf 1/1 2/2 3/3\n"
    (folder / "a.obj").write_text(faces)
    (folder / "a.mtl").write_text("newmtl m\n" + text)
    return load_scene(folder / "a.obj").materials


def numbers(materials):
    columns = (materials.model, materials.roughness, materials.metallic, materials.cutoff)
    model, *rest = (column[0].item() for column in columns)
    return MODELS[model], *(round(value, 6) for value in rest)


# Read


def test_gltf_is_metallic_roughness_with_the_formats_defaults(tmp_path):
    assert numbers(load_scene(gltf(tmp_path)).materials) == ("metallic_roughness", 1, 1, 0.5)
    assert numbers(load_scene(Builder().primitive().glb(tmp_path / "a.glb")).materials)[:3] == (
        "metallic_roughness",
        1,
        1,
    )
    path = gltf(tmp_path, roughnessFactor=0.25, metallicFactor=0.75)
    assert numbers(load_scene(path).materials) == ("metallic_roughness", 0.25, 0.75, 0.5)
    assert numbers(load_scene(path, model="lambert").materials)[0] == "lambert"
    with pytest.raises(ValueError, match=r"model: expected one of lambert, .* got velvet"):
        load_scene(path, model="velvet")


def test_gltf_factors_are_green_and_blue(tmp_path):
    image = np.arange(12).reshape(2, 2, 3)
    materials = load_scene(gltf(tmp_path, CUT, image)).materials
    assert materials.surfaces[0].tolist() == image[..., 1:].tolist()
    assert materials.textures[0].tolist() == np.array(CUT)[..., :3].tolist()
    assert materials.opacities == ()  # alpha means nothing to an opaque material


def test_images_of_factors_are_placed_as_the_colours_are(tmp_path):
    moved = {"extensions": {"KHR_texture_transform": {"offset": [0.5, 0]}}}
    path = gltf(tmp_path, None, [[[0, 1, 2]]], metallicRoughnessTexture=moved)
    assert load_scene(path).uv.tolist() == [[0.5, 1], [1.5, 1], [0.5, 0]]
    path = gltf(tmp_path, CUT, [[[0, 1, 2]]], metallicRoughnessTexture=moved)
    with pytest.warns(UserWarning, match="the image of its roughness is placed as that of its colour"):
        assert load_scene(path).uv.tolist() == [[0, 1], [1, 1], [0, 0]]


@pytest.mark.parametrize(
    ("material", "factor", "cutoff"),
    [
        ({"alphaMode": "MASK"}, 1.0, 0.5),
        ({"alphaMode": "MASK", "alphaCutoff": 0.75}, 1.0, 0.75),
        ({"alphaMode": "MASK", "alphaCutoff": 0.3}, 0.5, 0.6),  # 0.5 alpha < 0.3 where alpha < 0.6
    ],
)
def test_gltf_masks(tmp_path, material, factor, cutoff):
    materials = load_scene(gltf(tmp_path, CUT, material=material, baseColorFactor=[1, 1, 1, factor])).materials
    assert materials.opacities[0].tolist() == [[255, 10], [200, 128]]
    assert numbers(materials)[3] == pytest.approx(cutoff)


def test_masks_that_hide_nothing_or_everything(tmp_path):
    load = lambda material, *pixels, **more: load_scene(gltf(tmp_path, *pixels, material=material, **more)).materials  # noqa: E731
    assert not load({"alphaMode": "MASK", "alphaCutoff": 0.03}, CUT).has_cutouts
    assert not load({"alphaMode": "MASK"}).has_cutouts
    for hidden in (
        load({"alphaMode": "MASK"}, baseColorFactor=[1, 1, 1, 0.4]),
        load({"alphaMode": "MASK", "alphaCutoff": 7}, CUT),
    ):
        assert hidden.opacities[0].max() / 255 < hidden.cutoff[0]


def test_what_is_half_transparent_is_cut_at_one_half(tmp_path):
    with pytest.warns(UserWarning, match=r"'material 0': half transparent in the file, it has holes"):
        materials = load_scene(gltf(tmp_path, CUT, material={"alphaMode": "BLEND", "alphaCutoff": 0.9})).materials
    assert numbers(materials)[3] == 0.5
    assert materials.opacities[0].tolist() == [[255, 10], [200, 128]]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"roughnessFactor": 1.5}, "expected roughness and metallic from 0 to 1, got 1.5 and 1.0"),
        ({"metallicFactor": -1}, "expected roughness and metallic from 0 to 1"),
        ({"material": {"extras": {"fovden": {"model": "velvet"}}}}, "expected a model of lambert, .*, got 'velvet'"),
    ],
)
def test_each_fault_of_a_gltf_material_is_one_clear_error(tmp_path, change, message):
    with pytest.raises(SceneFileError, match=message):
        load_scene(gltf(tmp_path, **change))


def test_libraries_are_lambertian_without_roughness_or_metal(tmp_path):
    assert numbers(mtl(tmp_path, "Kd 1 1 1\nNs 90\nKs 1 1 1\nd 0.1\n")) == ("lambert", 1, 0, 0.5)
    assert numbers(mtl(tmp_path, "Pr 0.3\n")) == ("metallic_roughness", 0.3, 0, 0.5)
    assert numbers(mtl(tmp_path, "Pm 1\n")) == ("metallic_roughness", 1, 1, 0.5)
    with pytest.raises(SceneFileError, match="pr: expected one or three numbers from 0 to 1, got '2'"):
        mtl(tmp_path, "Pr 2\n")


def test_images_of_roughness_and_metal_in_libraries(tmp_path):
    for name, value in (("r", 10), ("m", 20), ("large", 30)):
        Image.new("L", (3, 2) if name != "large" else (4, 2), value).save(tmp_path / f"{name}.png")
    materials = mtl(tmp_path, "map_Pr r.png\nPr 0.5\n")
    assert numbers(materials)[:3] == ("metallic_roughness", 0.5, 0)
    assert materials.surfaces[0].unique(dim=0).tolist() == [[[10, 255]] * 3]
    materials = mtl(tmp_path, "map_Pr r.png\nmap_Pm m.png\n")
    assert numbers(materials)[:3] == ("metallic_roughness", 1, 1)
    assert materials.surfaces[0].unique(dim=0).tolist() == [[[10, 20]] * 3]
    with pytest.raises(SceneFileError, match=r"a\.mtl:2: material 'm', map_pr: .*\(2, 3\) texels"):
        mtl(tmp_path, "map_Pr r.png\nmap_Pm large.png\n")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("map_d grey.png", [[255, 10], [200, 128]]),
        ("map_d cut.png", [[255, 10], [200, 128]]),  # alpha, not the colours
        ("map_d -imfchan m cut.png", [[255, 10], [200, 128]]),
        ("map_d -imfchan l cut.png", [[76, 150], [29, 226]]),
        ("map_d grey.png\nd 0.25", [[0]]),  # 0.25 * 1 < 0.5: a hole everywhere
    ],
)
def test_cutouts_of_libraries(tmp_path, text, expected):
    Image.fromarray(np.array(CUT, dtype=np.uint8)).save(tmp_path / "cut.png")
    Image.fromarray(np.array(CUT, dtype=np.uint8)[..., 3]).save(tmp_path / "grey.png")
    materials = mtl(tmp_path, text + "\n")
    assert materials.opacities[0].tolist() == expected
    assert materials.cutoff.tolist() == [0.5]


def test_an_image_with_cutouts_is_decoded_once(tmp_path):
    Image.fromarray(np.array(CUT, dtype=np.uint8)).save(tmp_path / "cut.png")
    mtl(tmp_path, "map_Kd cut.png\nmap_d cut.png\nnewmtl n\nmap_d ./cut.png\nmap_Kd cut.png\n")
    with (tmp_path / "a.obj").open("a") as file:
        file.write("usemtl n\nf 1/1 2/2 3/3\n")
    materials = load_scene(tmp_path / "a.obj").materials
    assert materials.opacity.tolist() == materials.texture.tolist() == [0, 0]


def test_sponzas_plants_and_chains_are_cut_out(shared_scenes):
    materials = load_scene(shared_scenes / "sponza" / "sponza.obj").materials
    cut = {name for name, image in zip(materials.names, materials.opacity.tolist(), strict=True) if image >= 0}
    assert cut == {"leaf", "Material__57", "chain"}
    assert MODELS[int(materials.model.max())] == "lambert"
    for image in materials.opacities:
        holes = (image < 128).double().mean()
        assert 0.1 < holes < 0.9


# Write and read again


def images():
    generator = torch.Generator().manual_seed(5)
    draw = lambda *shape: torch.randint(0, 256, shape, generator=generator, dtype=torch.uint8)  # noqa: E731
    return draw(4, 6, 3), draw(4, 6), draw(3, 5, 2)


def assorted():
    """One square of each kind of material."""
    colours, opacity, factors = images()
    materials = [
        Material("chalk", (0.5, 0.25, 1), texture=colours),
        Material("leaf", (1, 1, 1), texture=colours, opacity=opacity),
        Material("net", (0.25, 1, 1), opacity=opacity, cutoff=0.3),
        Material("clay", (0.5, 0.25, 1), model="oren_nayar", roughness=0.4),
        Material("tin", (0.9, 0.75, 0.5), model="ggx", roughness=0.3),
        Material("test", (0.9, 0.75, 0.5), model="ggx_separable", roughness=0.7),
        Material("lacquer", (0.9, 0, 0), model="metallic_roughness", roughness=0.2, metallic=0.1),
        Material("rust", (1, 1, 1), (0, 2, 1), colours, "metallic_roughness", 0.8, 0.6, factors, opacity, 0.75),
    ]
    parts = [(rectangle((i, 0, 0), (1, 0, 0), (0, 1, 0)), material) for i, material in enumerate(materials)]
    scene = scene_of(parts)
    uv = torch.rand(len(scene.vertices), 2, generator=torch.Generator().manual_seed(1))
    return replace(scene, uv=uv)


def described(materials, number):
    """A material as it matters: images themselves, numbers that its model reads."""
    model = MODELS[materials.model[number]]
    texture, opacity, surface = (int(t[number]) for t in (materials.texture, materials.opacity, materials.surface))
    mixed = model == "metallic_roughness"
    return {
        "name": materials.names[number],
        "model": model,
        "albedo": materials.albedo[number].tolist(),
        "emission": materials.emission[number].tolist(),
        "roughness": float(materials.roughness[number]) if model != "lambert" else None,
        "metallic": float(materials.metallic[number]) if mixed else None,
        "texture": materials.textures[texture].tolist() if texture >= 0 else None,
        "opacity": materials.opacities[opacity].tolist() if opacity >= 0 else None,
        "surface": materials.surfaces[surface].tolist() if surface >= 0 else None,
        "cutoff": float(materials.cutoff[number]) if opacity >= 0 else None,
    }


@pytest.mark.parametrize("ending", ["glb", "gltf", "obj"])
def test_all_of_a_material_comes_back(tmp_path, ending):
    scene = assorted()
    again = load_scene(scene.export(tmp_path / f"a.{ending}")[-1])
    for number, name in enumerate(scene.materials.names):
        before, after = described(scene.materials, number), described(again.materials, number)
        if before["texture"] is None and before["opacity"] and ending != "obj":
            # A picture with alpha has colours: white ones.
            assert np.unique(after.pop("texture")).tolist() == [255]
            before.pop("texture")
        assert after == before, name
    corners = [s.vertices[s.faces.long()] for s in (scene, again)]
    uv = [s.uv[s.faces.long()] for s in (scene, again)]
    assert torch.equal(*corners)
    torch.testing.assert_close(*uv, rtol=0, atol=1e-6)  # also of what has an opacity or factors alone


def test_exports_again_are_the_same(tmp_path):
    """What was read says the same when it is written: nothing is lost by degrees."""
    once = load_scene(assorted().export(tmp_path / "a.glb")[-1])
    twice = load_scene(once.export(tmp_path / "b.glb")[-1])
    for number in range(len(once.materials.names)):
        assert described(once.materials, number) == described(twice.materials, number)


def test_other_programs_read_what_is_nearest(tmp_path):
    header, _ = glb_chunks(assorted().export(tmp_path / "a.glb")[-1])
    entries = {material["name"]: material for material in header["materials"]}
    factors = {
        name: tuple(entry["pbrMetallicRoughness"][key] for key in ("metallicFactor", "roughnessFactor"))
        for name, entry in entries.items()
    }
    assert factors == {
        "chalk": (0, 1),
        "leaf": (0, 1),
        "net": (0, 1),
        "clay": (0, 1),
        "tin": (1, 0.3),
        "test": (1, 0.7),
        "lacquer": (0.1, 0.2),
        "rust": (0.6, 0.8),
    }
    modes = {name: (entry.get("alphaMode"), entry.get("alphaCutoff")) for name, entry in entries.items()}
    assert {name for name, mode in modes.items() if mode[0]} == {"leaf", "net", "rust"}
    assert (modes["leaf"], modes["net"], modes["rust"]) == (("MASK", 0.5), ("MASK", 0.3), ("MASK", 0.75))
    assert [name for name, entry in entries.items() if "extras" in entry] == [
        "chalk",
        "leaf",
        "net",
        "clay",
        "tin",
        "test",
    ]
    assert len(header["images"]) == 4  # colours, the same cut out, white cut out, factors
    library = mtl_materials(assorted().export(tmp_path / "a.obj")[-3])
    assert {name: (entry.get("Pr"), entry.get("Pm")) for name, entry in library.items() if "Pr" in entry} == {
        "tin": ("0.3", "1"),
        "test": ("0.7", "1"),
        "lacquer": ("0.2", "0.1"),
        "rust": ("0.8", "0.6"),
    }
    assert {name: entry["#fovden"] for name, entry in library.items() if "#fovden" in entry} == {
        "net": "cutoff 0.3",
        "clay": "model oren_nayar roughness 0.4 metallic 0",
        "tin": "model ggx roughness 0.3 metallic 0",
        "test": "model ggx_separable roughness 0.7 metallic 0",
        "rust": "cutoff 0.75",
    }
    assert "materials" in json.loads((tmp_path / "a.json").read_text())


def test_a_metals_image_says_that_it_is_whole(tmp_path):
    """Microfacets of a metal have no share of metal: other programs find 1 in the image that also has the roughness."""
    _, _, factors = images()
    tin = Material("tin", (1, 1, 1), model="ggx", roughness=0.5, surface=factors)
    scene = scene_of([(rectangle((0, 0, 0), (1, 0, 0), (0, 1, 0)), tin)])
    for ending in ("glb", "obj"):
        again = load_scene(scene.export(tmp_path / f"a.{ending}")[-1]).materials
        assert torch.equal(again.surfaces[0][..., 0], factors[..., 0])
        assert (again.surfaces[0][..., 1] == 255).all()


def test_opacity_of_another_size_than_the_colours_is_resampled(tmp_path):
    colours, _, _ = images()
    opacity = torch.tensor([[0, 255]], dtype=torch.uint8)
    leaf = Material("leaf", (1, 1, 1), texture=colours, opacity=opacity)
    scene = scene_of([(rectangle((0, 0, 0), (1, 0, 0), (0, 1, 0)), leaf)])
    with pytest.warns(UserWarning, match=r"an opacity image of \(1, 2\) texels is resampled .* \(4, 6\)"):
        path = scene.export(tmp_path / "a.glb")[-1]
    again = load_scene(path).materials
    assert torch.equal(again.textures[0], colours)
    assert again.opacities[0].shape == (4, 6)
    assert (again.opacities[0] >= 128).tolist() == [[False] * 3 + [True] * 3] * 4
