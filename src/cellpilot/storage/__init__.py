"""Files: written whole or not at all, checked before they are believed, and held while somebody works on them."""

from cellpilot.storage.arrays import load_array, save_array
from cellpilot.storage.atomic import TEMPORARY, write_atomically
from cellpilot.storage.folders import new_folder
from cellpilot.storage.hold import LOCK, hold
from cellpilot.storage.netcdf import load_netcdf, save_netcdf
from cellpilot.storage.seal import check_seal, digest_of_bytes, seal
from cellpilot.storage.tensors import load_tensors, save_tensors
from cellpilot.storage.texts import parse_json, read_json, read_text, resolved, write_json

__all__ = [
    "LOCK",
    "TEMPORARY",
    "check_seal",
    "digest_of_bytes",
    "hold",
    "load_array",
    "load_netcdf",
    "load_tensors",
    "new_folder",
    "parse_json",
    "read_json",
    "read_text",
    "resolved",
    "save_array",
    "save_netcdf",
    "save_tensors",
    "seal",
    "write_atomically",
    "write_json",
]
