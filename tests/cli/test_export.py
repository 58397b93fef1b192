"""``pellucid export`` from the command line."""


def test_it_writes_a_page_with_a_still_picture(run, tmp_path):
    result = run("export", "horned_head", "--size", "20", "--material", "skin1")
    text = (tmp_path / "horned_head.html").read_text()
    assert "wrote horned_head.html" in result.output
    assert len(text) < 300_000
    assert "data:image/jpeg;base64,/9j/" in text
    assert sorted(path.name for path in tmp_path.iterdir()) == ["horned_head.html"]


def test_what_it_cannot_show_is_refused_before_anything_is_written(run, scene_file, tmp_path):
    assert "Sphere: export it as a mesh" in run("export", scene_file, code=2).output
    assert "'.png' is no kind of file" in run("export", "horned_head", "-o", "a.png", code=2).output
    assert not list(tmp_path.glob("*.html"))
