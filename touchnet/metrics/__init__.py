"""How good a reconstruction is: of point sets (torch), of occupancies, and of meshes (numpy, float64).

Papers differ in what they call Chamfer distance or F-score; `DEFINITIONS` says what each name means here, and every
report prints it. Distances are in the units of the input; reports use the longest side of the shape's box as the unit.
"""

from touchnet.metrics.clouds import chamfer_distance, f_score, hausdorff_95, nearest, normal_consistency
from touchnet.metrics.protocols import DEFINITIONS, THRESHOLDS, PaperTruth, SurfaceTruth, surface_keys
from touchnet.metrics.surfaces import inside_mesh, is_closed, point_to_mesh, sample_surface
from touchnet.metrics.volumes import volumetric_iou

__all__ = [
    "DEFINITIONS",
    "THRESHOLDS",
    "PaperTruth",
    "SurfaceTruth",
    "chamfer_distance",
    "f_score",
    "hausdorff_95",
    "inside_mesh",
    "is_closed",
    "nearest",
    "normal_consistency",
    "point_to_mesh",
    "sample_surface",
    "surface_keys",
    "volumetric_iou",
]
