"""Reads safetensors into torch tensors."""
import json

import torch

DTYPES = {"F32": torch.float32, "F64": torch.float64, "BF16": torch.bfloat16, "F16": torch.float16,
          "I64": torch.int64, "I32": torch.int32, "U8": torch.uint8, "BOOL": torch.bool}


def read(path):
    """-> (tensors by name, metadata)"""
    with open(path, "rb") as file:
        data = bytearray(file.read())
    size = int.from_bytes(data[:8], "little")
    header = json.loads(data[8:8 + size])
    metadata = header.pop("__metadata__", {})
    tensors = {}
    for name, info in header.items():
        first, last = info["data_offsets"]
        flat = torch.frombuffer(data, dtype=torch.uint8)[8 + size + first:8 + size + last]
        tensors[name] = flat.clone().view(DTYPES[info["dtype"]]).reshape(info["shape"])
    return tensors, metadata
