"""Saving and loading models as safetensors: the architecture in the header, no pickle, float16 for what ships."""

from __future__ import annotations

import dataclasses
import json
import os
from importlib import resources
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import nn

from touchnet.config import architecture_of, model_config_from_dict
from touchnet.models import build_model
from touchnet.outputs import atomic_output

FORMAT = "touchnet-weights"


def save_weights(
    model: nn.Module, path: str | os.PathLike, *, half: bool = False, notes: dict[str, str] | None = None
) -> None:
    """Writes `model` to `path` (moved into place when complete).

    Args:
        half: store floating-point tensors as float16 (half the size; loading restores float32).
        notes: further strings for the header, such as the training command.
    """
    path = Path(path)
    tensors = {}
    for name, tensor in model.state_dict().items():
        tensor = tensor.detach().cpu().contiguous()
        tensors[name] = tensor.half() if half and tensor.is_floating_point() else tensor
    header = {
        "format": FORMAT,
        "architecture": architecture_of(model.config),
        "config": json.dumps(dataclasses.asdict(model.config)),
        **(notes or {}),
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_output(path, force=True) as temporary:
        temporary.write_bytes(save(tensors, metadata=header))


def load_model(name_or_path: str | os.PathLike = "default", *, device: str | torch.device = "cpu") -> nn.Module:
    """A trained model in evaluation mode.

    Args:
        name_or_path: "default" (the weights inside the package) or the path of a .safetensors file that
            :func:`save_weights` or ``touchnet train`` wrote.
        device: where to put it.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file is not one of touchnet's weights.
    """
    path = find_weights(name_or_path)
    try:
        with safe_open(path, framework="pt") as file:
            header = file.metadata() or {}
            state = {name: file.get_tensor(name) for name in file.keys()}
    except SafetensorError as error:
        raise ValueError(f"weights: {path} is not a safetensors file ({error})") from None
    if header.get("format") != FORMAT or "config" not in header:
        raise ValueError(f"weights: {path} was not written by touchnet (its header has no format {FORMAT!r})")
    architecture = header.get("architecture", "touchnet")  # files of the first version have none
    model = build_model(model_config_from_dict(json.loads(header["config"]), architecture))
    state = {name: tensor.float() if tensor.is_floating_point() else tensor for name, tensor in state.items()}
    try:
        model.load_state_dict(state)
    except RuntimeError as error:
        raise ValueError(f"weights: {path} does not fit its own configuration ({str(error).splitlines()[0]})") from None
    return model.to(device).eval().requires_grad_(False)


def find_weights(name_or_path: str | os.PathLike) -> Path:
    """The file that :func:`load_model` would read; FileNotFoundError where there is none."""
    path = shipped_weights(name_or_path) if isinstance(name_or_path, str) else None
    path = path or Path(name_or_path)
    if not path.is_file():
        raise FileNotFoundError(f"weights: no such file {path}; the package has {', '.join(shipped_names()) or 'none'}")
    return path


def read_notes(name_or_path: str | os.PathLike) -> dict[str, str]:
    """The strings in the header of a file of weights, without reading the weights."""
    with safe_open(find_weights(name_or_path), framework="pt") as file:
        return dict(file.metadata() or {})


def shipped_names() -> list[str]:
    """Names of the weights inside the package."""
    folder = resources.files("touchnet") / "pretrained"
    if not folder.is_dir():
        return []
    return sorted(
        entry.name.removesuffix(".safetensors") for entry in folder.iterdir() if entry.name.endswith(".safetensors")
    )


def shipped_weights(name: str) -> Path | None:
    """Path of the shipped weights called `name`; None where there are none of that name."""
    if name not in shipped_names():
        return None
    return Path(str(resources.files("touchnet") / "pretrained" / f"{name}.safetensors"))
