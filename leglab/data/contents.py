"""Detection of the format of a file or folder by its first bytes, else by its suffix."""

from pathlib import Path

from leglab.base.errors import FileError
from leglab.base.input import read_bytes
from leglab.data.lerobot import is_dataset

SUFFIXES = {
    ".parquet": "parquet",
    **dict.fromkeys((".csv", ".txt", ".tsv", ".log", ".dat", ".asc"), "csv"),
    ".mcap": "mcap",
    ".mat": "matlab",
    ".npz": "sysid",
}
"""Formats by suffix, in small letters."""

_MAGIC = {
    b"PAR1": "parquet",
    b"\x89MCAP": "mcap",
    b"SQLite format 3": "mcap",
    b"\x89HDF\r\n\x1a\n": "hdf5",
    b"MATLAB ": "matlab",
    b"PK\x03\x04": "zip",
    b"\xd0\xcf\x11\xe0": "excel",
    b"\x1f\x8b": "gzip",
    b"\x28\xb5\x2f\xfd": "zstd",
    b"\x93NUMPY": "npy",
    b"#ROSBAG": "bag 1",
}
# Formats that leglab does not read, with a command to convert them; {0} is the file, {1} its stem.
_WAYS_OUT = {
    "hdf5": "HDF5 is not read; convert: python -c \"import h5py, numpy; f = h5py.File('{0}'); d = "
    "{{}}; f.visititems(lambda n, x: d.update({{n: x[()]}}) if isinstance(x, h5py.Dataset) else "
    "None); numpy.savez('{1}.npz', **d)\"",
    "excel": 'a workbook of Excel is not read; convert: python -c "import pandas; pandas.read_excel'
    "('{0}').to_csv('{1}.csv', index=False)\"",
    "gzip": "packed by gzip; unpack: gunzip -k '{0}'",
    "zstd": "packed by zstd; unpack: unzstd '{0}'",
    "npy": "one array of NumPy has no names; save columns by numpy.savez('{1}.npz', time=..., "
    "knee_position=...)",
    "bag 1": "a bag of ROS 1; convert: pip install rosbags && rosbags-convert --src"
    "  '{0}' --dst '{1}'",
}


def form_of_folder(path: Path) -> str | None:
    """Returns the format of a folder that is read as a whole; None for a folder of files."""
    if (path / "meta" / "info.json").is_file():
        return "lerobot"
    bag = any(path.glob("*.mcap.zstd")) or any(path.glob("*.db3*"))
    return "mcap" if bag or (path / "metadata.yaml").is_file() else None


def form_at(path: Path) -> str:
    """Returns the format of a file or folder.

    Raises:
        LeglabError: It cannot be read, or its format is unknown or unsupported; names a remedy.
    """
    if path.is_dir():
        return form_of_folder(path) or "mcap"
    head = read_bytes(path, 16)
    suffixes = [suffix.lower() for suffix in path.suffixes[-2:]]
    form = next((form for magic, form in _MAGIC.items() if head.startswith(magic)), None)
    if form == "zip":  # A NumPy archive, unless the suffix is Excel's.
        form = "excel" if suffixes[-1:] in ([".xlsx"], [".xlsm"]) else None
    elif form == "gzip" and any(SUFFIXES.get(suffix) == "csv" for suffix in suffixes):
        form = "csv"
    elif form == "zstd" and suffixes == [".mcap", ".zstd"]:
        form = "mcap"
    elif form == "parquet" and is_dataset(path):
        form = "lerobot"
    if form in _WAYS_OUT:
        raise FileError(f"{path}: {_WAYS_OUT[form].format(path, path.stem)}", given=path)
    if form is None and suffixes and suffixes[-1] in (".h5", ".hdf5", ".xlsx", ".xls"):
        raise FileError(f"{path}: not a complete {suffixes[-1]} file", given=path)
    return form or format_of(path)


def format_of(path: str | Path) -> str:
    """Returns the format for the suffix of a file.

    Raises:
        LeglabError: The suffix is not known.
    """
    path = Path(path)
    if path.suffix.lower() not in SUFFIXES:
        text = f"{path}: suffix {path.suffix!r} is not a known format, allowed: "
        raise FileError(text, given=path.suffix, allowed=SUFFIXES)
    return SUFFIXES[path.suffix.lower()]
