"""An object of Gaussians that was never trained, without normals and without a light."""

from pcore.asset.asset import WHITE, Asset
from pcore.asset.gaussian_content import GaussianContent
from pcore.files.provenance import Provenance
from pcore.files.run_record import RunRecord
from pcore.gaussians.gaussians import Gaussians
from pcore.gaussians.render import Footprint


def asset_of_gaussians(gaussians: Gaussians) -> Asset:
    came = Provenance(
        scene="none",
        stage="pretrain",
        step=1,
        background=WHITE,
        extent=((-1.0, -1.0, -1.0), (1.0, 1.0, 1.0)),
        pcore="0",
    )
    content = GaussianContent(gaussians=gaussians, footprint=Footprint(), background=WHITE)
    return Asset(content=content, provenance=came, record=RunRecord(stage="pretrain"))
