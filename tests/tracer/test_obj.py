"""OBJ files: order, materials, indices, and what is wrong with a file. Expectations are worked out by hand."""

import warnings

import numpy as np
import pytest
import torch

from fovden.tracer.formats.scene_file import SceneFileError
from fovden.tracer.meshes import load_scene

SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"


def obj(folder, text, mtl=None):
    if mtl is not None:
        (folder / "a.mtl").write_bytes(mtl.encode())
    path = folder / "a.obj"
    path.write_bytes(text.encode())
    return path


def test_faces_keep_the_files_order_over_interleaved_and_reused_groups(tmp_path):
    mtl = "newmtl b\nKd 0.2 0 0\nnewmtl a\nKd 0.1 0 0\n"
    faces = "usemtl a\nf 1 2 3\nusemtl b\nf 2 3 4\ng x\nf 3 4 1\nusemtl a\nf 4 1 2\n"
    scene = load_scene(obj(tmp_path, "mtllib a.mtl\n" + SQUARE + faces, mtl))
    assert scene.faces.tolist() == [[0, 1, 2], [1, 2, 3], [2, 3, 0], [3, 0, 1]]
    assert scene.materials.names == ("a", "b")  # by their first face
    assert scene.material_ids.tolist() == [0, 1, 1, 0]
    torch.testing.assert_close(scene.materials.albedo[:, 0], torch.tensor([0.1, 0.2]), rtol=0, atol=0)
    assert scene.vertices.tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]


def test_polygons_become_fans_in_place(tmp_path):
    text = SQUARE + "v 0 2 0\nv -1 1 0\nf 1 2 3 4 5 6\nf 1 2 3\nf 1 2 3 4\n"
    expected = [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5], [0, 1, 2], [0, 1, 2], [0, 2, 3]]
    assert load_scene(obj(tmp_path, text)).faces.tolist() == expected


def test_degenerate_and_repeated_faces_are_kept(tmp_path):
    scene = load_scene(obj(tmp_path, SQUARE + "f 1 1 2\nf 1 2 3\nf 1 2 3\nf 4 4 4\n"))
    assert scene.faces.tolist() == [[0, 0, 1], [0, 1, 2], [0, 1, 2], [3, 3, 3]]


def test_negative_indices_count_back_from_their_line(tmp_path):
    text = "v 0 0 0\nv 1 0 0\nv 1 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nf -3/-3 -2/-2 -1/-1\n"
    text += "v 9 9 9\nvt 0.5 0.5\nf 1/-1 2/-2 -1/1\n"
    scene = load_scene(obj(tmp_path, text))
    assert scene.vertices[scene.faces[0]].tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0]]
    assert scene.uv[scene.faces[0]].tolist() == [[0, 0], [1, 0], [1, 1]]
    assert scene.vertices[scene.faces[1]].tolist() == [[0, 0, 0], [1, 0, 0], [9, 9, 9]]
    assert scene.uv[scene.faces[1]].tolist() == [[0.5, 0.5], [1, 1], [0, 0]]


def test_a_vertex_with_several_attributes_is_repeated_after_the_files_vertices(tmp_path):
    text = SQUARE + "v 7 7 7\nvt 0 0\nvt 0.25 0.75\nvn 0 0 2\nvn 3 0 0\n"
    text += "f 1/1/1 2/1/1 3/1/1\nf 1/2/1 3/1/1 4//2\nf 1/2/1 2/1/2 3\n"
    scene = load_scene(obj(tmp_path, text))
    # The five v lines, then 1/2/1, 2/1/2 and 3 as they appear.
    assert scene.vertices.tolist()[:5] == [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [7, 7, 7]]
    assert scene.vertices.tolist()[5:] == [[0, 0, 0], [1, 0, 0], [1, 1, 0]]
    assert scene.faces.tolist() == [[0, 1, 2], [5, 2, 3], [5, 6, 7]]
    assert scene.uv.tolist() == [[0, 0], [0, 0], [0, 0], [0, 0], [0, 0], [0.25, 0.75], [0, 0], [0, 0]]
    up, right, none = [0, 0, 1], [1, 0, 0], [0, 0, 0]  # made unit; zero where a face gives none
    assert scene.normals.tolist() == [up, up, up, right, none, up, right, none]


def test_line_ends_continuations_comments_and_layout_do_not_matter(tmp_path):
    plain = load_scene(obj(tmp_path, SQUARE + "f 1 2 3\nf 1 3 4\n"))
    odd = "\ufeff# made by hand\r\nv\t0 0 0 # first\r\n  v 1 0 0\r\nv 1 \\\r\n1 0\r\n\r\nv 0 1e0 -0.0\r\n"
    odd += "s off\r\nf 1 2 \\\r\n\\\r\n3 # last\r\nf 1 3 4"
    other = load_scene(obj(tmp_path, odd))
    torch.testing.assert_close(other.vertices, plain.vertices)
    assert other.faces.tolist() == plain.faces.tolist()


def test_old_mac_line_ends_and_latin_1(tmp_path):
    path = tmp_path / "a.obj"
    path.write_bytes((SQUARE + "o caf\u00e9\nf 1 2 3\n").replace("\n", "\r").encode("latin-1"))
    assert load_scene(path).faces.tolist() == [[0, 1, 2]]


def test_colours_fourth_coordinates_and_short_texture_coordinates(tmp_path):
    text = "v 0 0 0 1 0 0\nv 1 0 0 0 1 0\nv 1 1 0 1.0\nvt 0.5\nvt 0.5 0.25 0\nf 1/1 2/2 3/2\n"
    scene = load_scene(obj(tmp_path, text))
    assert scene.vertices.tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0]]
    assert scene.uv.tolist() == [[0.5, 0], [0.5, 0.25], [0.5, 0.25]]


def test_faces_above_the_first_usemtl_are_default_grey_even_beside_a_material_of_that_name(tmp_path):
    text = "mtllib a.mtl\n" + SQUARE + "f 1 2 3\nusemtl default\nf 1 3 4\n"
    scene = load_scene(obj(tmp_path, text, "newmtl default\nKd 0.25 0.25 0.25"))
    assert scene.materials.names == ("default", "default")
    assert scene.materials.albedo[:, 0].tolist() == [0.5, 0.25]
    assert scene.material_ids.tolist() == [0, 1]


def test_material_names_with_spaces_and_hashes_and_several_libraries(tmp_path):
    (tmp_path / "my brick.mtl").write_text("newmtl Material #25\nKd 0.25 0.5 0.75\n")
    (tmp_path / "b.mtl").write_text("newmtl b\nKd 0.5 0.5 0.5\n")
    (tmp_path / "c.mtl").write_text("newmtl c\nKd 0.125 0.5 0.5\n")
    text = SQUARE + "usemtl Material #25\nf 1 2 3\nusemtl c\nf 1 3 4\nmtllib my brick.mtl\nmtllib b.mtl c.mtl\n"
    scene = load_scene(obj(tmp_path, text))
    assert scene.materials.names == ("Material #25", "c")
    assert scene.materials.albedo[:, 0].tolist() == [0.25, 0.125]


def test_materials_without_a_library_are_grey_with_a_warning(tmp_path):
    path = obj(tmp_path, SQUARE + "usemtl stone\nf 1 2 3\n")
    with pytest.warns(UserWarning, match=r"a\.obj:5: the file names no material library; 'stone' is grey"):
        assert load_scene(path).materials.albedo.tolist() == [[0.5, 0.5, 0.5]]


def test_an_unknown_statement_warns_once_with_its_line(tmp_path):
    path = obj(tmp_path, SQUARE + "surf 0 1 0 1\ncurv 0 1\nf 1 2 3\n")
    with pytest.warns(UserWarning, match=r"a\.obj:5: the unknown statement 'surf'") as record:
        load_scene(path)
    assert len(record) == 1


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("f 1 2 5", r"a\.obj:5: 'f 1 2 5' refers to what is not there \(the file has 4 v, 0 vt, 0 vn\)"),
        ("f 1 2 3\nf 1 2 3 4 9", r"a\.obj:6: 'f 1 2 3 4 9' refers"),
        ("f 1 2 -5", r"a\.obj:5: 'f 1 2 -5' refers"),
        ("f 1 2 0", r"a\.obj:5: 'f 1 2 0' refers"),
        ("f 1/0 2/0 3/0", r"a\.obj:5: .* refers"),
        ("f 1/1 2/1 3/1", r"a\.obj:5: .* refers"),
        ("f 1/1/1 2/1/1 3/1/1", r"a\.obj:5: .* refers"),
        ("f 1//1 2//1 3//1", r"a\.obj:5: .* refers"),
        ("f /1 2 3", r"a\.obj:5: .* refers"),
        ("f 1 2 3.5", r"a\.obj:5: .* refers"),
        ("f 1 2 x", r"a\.obj:5: .* refers"),
        ("f 1/1/1/1 2 3", r"a\.obj:5: .* refers"),
        ("f 1 2 99999999999999999999999", r"a\.obj:5: .* refers"),
        ("f 1 2", r"a\.obj:5: expected a face of at least 3 corners, got 'f 1 2'"),
        ("f", r"a\.obj:5: expected a face"),
        ("v nan 0 0\nf 1 2 3", r"a\.obj:5: expected 3 finite numbers, got 'v nan 0 0'"),
        ("v 0 inf 0\nf 1 2 3", r"a\.obj:5: expected 3 finite numbers"),
        ("vn 0 0 nan\nf 1 2 3", r"a\.obj:5: expected 3 finite numbers"),
        ("vt nan 0\nf 1 2 3", r"a\.obj:5: expected 1 finite numbers"),
        ("v 1 2\nf 1 2 3", r"a\.obj:5: expected 3 finite numbers, got 'v 1 2'"),
        ("v 1 2 # 3\nf 1 2 3", r"a\.obj:5: expected 3 finite numbers"),
        ("v 1 2 three\nf 1 2 3", r"a\.obj:5: expected 3 finite numbers"),
        ("v 1e300 0 0\nf 1 2 5", r"a\.obj: vertex 5 of 5 is not finite"),
        ("", r"a\.obj: the scene is empty: the file has no faces"),
        ("l 1 2\np 3", r"the scene is empty"),
    ],
)
def test_each_fault_of_a_line_is_one_clear_error(tmp_path, text, message):
    with pytest.raises(SceneFileError, match=message):
        load_scene(obj(tmp_path, SQUARE + text))


def test_a_library_or_a_material_that_is_missing_is_an_error_only_if_a_face_needs_it(tmp_path):
    path = obj(tmp_path, "mtllib lost.mtl\n" + SQUARE + "usemtl red\nf 1 2 3\n")
    with pytest.raises(FileNotFoundError, match=r"a\.obj:1: the material library 'lost\.mtl' is not there"):
        load_scene(path)
    path = obj(tmp_path, "mtllib a.mtl\n" + SQUARE + "usemtl red\nf 1 2 3\nusemtl x\nf 1 3 4\n", "newmtl x\nKd 0 0 0\n")
    with pytest.raises(SceneFileError, match=r"a\.obj:6: the material 'red' is not defined in a\.mtl"):
        load_scene(path)
    assert load_scene(path, skip_materials="RED").faces.tolist() == [[0, 2, 3]]


@pytest.mark.parametrize("mtllib", ["", " ", " a.mtl lost.mtl"])
def test_a_broken_mtllib_is_one_clear_error(tmp_path, mtllib):
    path = obj(tmp_path, f"mtllib{mtllib}\n{SQUARE}usemtl red\nf 1 2 3\n", "newmtl red\n")
    with pytest.raises(FileNotFoundError, match=r"a\.obj:1: the material library"):
        load_scene(path)


def test_a_file_cut_off_anywhere_loads_what_stands_there_or_says_what_is_wrong(tmp_path):
    mtl = "newmtl red\nKd 0.5 0 0\nnewmtl blue\nKd 0 0 0.5\n"
    whole = f"mtllib a.mtl\n{SQUARE}vt 0 0\nvn 0 0 1\nusemtl red\nf 1/1/1 2/1/1 3/1/1\n"
    whole += "usemtl blue\nf -4/1/1 -2/1/1 -1/1/1\n"
    complete = load_scene(obj(tmp_path, whole, mtl)).faces
    loaded = 0
    for length in range(len(whole)):
        path = obj(tmp_path, whole[:length])
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                scene = load_scene(path)
            except (SceneFileError, FileNotFoundError) as error:
                assert "a.obj" in str(error)  # noqa: PT017
                continue
        loaded += 1
        assert scene.triangle_count <= len(complete)
        assert scene.faces[0].tolist() == complete[0].tolist()
    assert loaded > 0


def test_noise_never_raises_anything_else(tmp_path):
    whole = bytearray((SQUARE + "vt 0 0\nvn 0 0 1\nusemtl red\nf 1/1/1 2/1/1 3/1/1\nf -4 -2 -1\n").encode())
    random = np.random.default_rng(0)
    errors = 0
    for _ in range(300):
        noisy = bytearray(whole)
        for place in random.integers(0, len(whole), 3):
            noisy[place] = random.integers(0, 256)
        (tmp_path / "a.obj").write_bytes(noisy)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                load_scene(tmp_path / "a.obj")
            except (SceneFileError, FileNotFoundError):
                errors += 1
    assert 0 < errors < 300
