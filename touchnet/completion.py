"""From contacts to a dense cloud of points in the contacts' own frame, by a network that gives points."""

from __future__ import annotations

import numpy as np
import torch
from torch import nn

from touchnet.contacts import check_contacts
from touchnet.device import pick_device
from touchnet.frames import Frame


def complete_points(
    points: np.ndarray, network: nn.Module, *, normals: np.ndarray | None = None, device: str | torch.device = "auto"
) -> np.ndarray:
    """The cloud that a network (`predicts` "points", such as GRNet) makes of contacts; the same every time.

    Args:
        points: (N, 3) contacts in any unit and offset, at least one, all finite.
        network: it is moved to the device and put into evaluation mode.
        normals: (N, 3) outward directions, used where the network does.
        device: "cpu", "cuda" or "auto".

    Returns:
        (K, 3) float64, in the frame and unit of the contacts.

    Raises:
        ValueError: contacts that are none or not finite, or a network that gives no points.
    """
    points, normals = check_contacts(points, normals)
    if getattr(network, "predicts", None) != "points":
        raise ValueError(f"network should give points, got a {type(network).__name__}")
    device = pick_device(device)
    frame = Frame.fit(points)

    def batch(rows: np.ndarray) -> torch.Tensor:
        return torch.from_numpy(rows).to(device=device, dtype=torch.float32)[None]

    with torch.inference_mode():
        cloud = (
            network.to(device).eval().points(batch(frame.to_cube(points)), None if normals is None else batch(normals))
        )
    return frame.from_cube(cloud[0].double().cpu().numpy())
