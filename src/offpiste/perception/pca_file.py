"""A PCA on disk: safetensors, with everything that is not a tensor as JSON in the file's own header."""

import json
from pathlib import Path

from safetensors import SafetensorError, safe_open
from safetensors.numpy import save_file

from offpiste.errors import PerceptionError
from offpiste.files import write_whole
from offpiste.perception.backbone import Backbone
from offpiste.perception.pca import PrincipalComponents

_SCHEMA = 1


def save_pca(path: Path, pca: PrincipalComponents) -> None:
    """Write it whole or not at all."""
    about = {
        "schema": _SCHEMA,
        "total_variance": pca.total_variance,
        "backbone": pca.backbone,
        "fingerprint": pca.fingerprint,
        "fitted_on": dict(pca.fitted_on),
    }
    tensors = {"mean": pca.mean, "basis": pca.basis.copy(), "variance": pca.variance.copy()}
    write_whole(path, lambda partial: save_file(tensors, partial, metadata={"offpiste_pca": json.dumps(about)}))


def load_pca(path: Path, backbone: Backbone | None = None) -> PrincipalComponents:
    """Read what `save_pca` wrote, and see to it that it belongs to the backbone, where one is given.

    Raises:
        PerceptionError: no such file, not a PCA, or one of another backbone or other weights.
    """
    try:
        with safe_open(path, framework="numpy") as file:
            about = json.loads((file.metadata() or {})["offpiste_pca"])
            mean, basis, variance = (file.get_tensor(name) for name in ("mean", "basis", "variance"))
        if about["schema"] != _SCHEMA:
            raise ValueError(f"schema {about['schema']}, not {_SCHEMA}")
        pca = PrincipalComponents(
            mean=mean,
            basis=basis,
            variance=variance,
            total_variance=float(about["total_variance"]),
            backbone=str(about["backbone"]),
            fingerprint=str(about["fingerprint"]),
            fitted_on=dict(about["fitted_on"]),
        )
    except (OSError, SafetensorError, KeyError, TypeError, ValueError) as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise PerceptionError(
            f"not a PCA of offpiste ({reason})", where=path, how="give the file that `offpiste fit-pca` wrote"
        ) from error
    if backbone is not None:
        pca.check(backbone, where=path)
    return pca
