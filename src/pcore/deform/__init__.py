"""Maps R^3 -> R^3: simple deforms, motions, composition, random draws."""

from pcore.deform.base import Affine, Compose, Deformation, Identity
from pcore.deform.checks import check_invertible
from pcore.deform.sampler import DeformationRanges, sample_deformation
from pcore.deform.simple import (
    AxialStretch,
    Bend,
    Stretch,
    Taper,
    Twist,
    VolumeStretch,
    rigid,
    uniform_scale,
)

__all__ = [
    "Affine",
    "AxialStretch",
    "Bend",
    "Compose",
    "Deformation",
    "DeformationRanges",
    "Identity",
    "Stretch",
    "Taper",
    "Twist",
    "VolumeStretch",
    "check_invertible",
    "rigid",
    "sample_deformation",
    "uniform_scale",
]
