import numpy as np
import pytest
import xarray as xr

from walker_jax import store

REQUEST = {"command": "basin", "slope": 0.004}


@pytest.fixture
def data():
    return xr.Dataset(
        {"fate": ("x", np.arange(5, dtype=np.int8))}, coords={"x": np.linspace(0, 1, 5)}
    )


def test_the_same_request_finds_its_result(tmp_path, data):
    path = tmp_path / "a.zarr"
    assert store.find(path, REQUEST) is None
    written = store.save(data, path, REQUEST)
    found = store.find(path, {"slope": 0.004, "command": "basin"})
    assert found is not None and found.identical(written)
    assert [p.name for p in tmp_path.iterdir()] == ["a.zarr"]
    assert xr.open_zarr(path, consolidated=False).identical(written)


def test_another_request_is_refused_unless_told_to_overwrite(tmp_path, data):
    path = tmp_path / "a.zarr"
    store.save(data, path, REQUEST)
    with pytest.raises(store.Occupied, match=r"a\.zarr holds another result"):
        store.find(path, {**REQUEST, "slope": 0.005})
    assert store.find(path, {**REQUEST, "slope": 0.005}, overwrite=True) is None
    assert store.find(path, REQUEST) is not None  # nothing was touched
    store.save(data * 2, path, {**REQUEST, "slope": 0.005})
    replaced = store.load(path)
    assert replaced is not None and replaced.fate.values.tolist() == [0, 2, 4, 6, 8]
    assert [p.name for p in tmp_path.iterdir()] == ["a.zarr"]


@pytest.mark.parametrize("overwrite", [False, True])
def test_what_is_no_data_set_is_never_replaced(tmp_path, overwrite):
    for name in ("file", "folder", "damaged"):
        path = tmp_path / name
        if name == "file":
            path.write_text("mine")
        else:
            path.mkdir()
        if name == "damaged":
            (path / "zarr.json").write_text("{")
        with pytest.raises(store.Occupied, match="is not a data set"):
            store.find(path, REQUEST, overwrite=overwrite)
        assert path.exists()


def test_places_that_cannot_be_written(tmp_path, monkeypatch):
    with pytest.raises(ValueError, match="no folder"):
        store.find(tmp_path / "none" / "a.zarr", REQUEST)
    monkeypatch.setattr(store.os, "access", lambda *_: False)
    with pytest.raises(ValueError, match="no permission"):
        store.find(tmp_path / "a.zarr", REQUEST)


def test_a_failed_write_leaves_what_was_there(tmp_path, data, monkeypatch):
    path = tmp_path / "a.zarr"
    written = store.save(data, path, REQUEST)
    monkeypatch.setattr(xr.Dataset, "to_zarr", lambda *_, **__: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        store.save(data * 2, path, REQUEST)
    found = store.find(path, REQUEST)
    assert found is not None and found.identical(written)
    assert [p.name for p in tmp_path.iterdir()] == ["a.zarr"]


def test_a_picture_is_known_by_its_title(tmp_path):
    path = tmp_path / "a.png"
    store.check_picture(path, REQUEST)
    path.write_bytes(b"x" + store.signature(REQUEST).encode() + b"y")
    store.check_picture(path, REQUEST)
    with pytest.raises(store.Occupied, match=r"a\.png is something else"):
        store.check_picture(path, {**REQUEST, "slope": 0.005})
    store.check_picture(path, {**REQUEST, "slope": 0.005}, overwrite=True)
