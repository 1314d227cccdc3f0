"""Policy files for `./vlaps up --policy`: `Policy` reads them, `export` writes them."""

from __future__ import annotations

import importlib.util
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _vlaps

#: Numbers in a policy's input: those of the default lidar.
FEATURES = 259
#: Number of probes that `export` writes into a file, and the tolerance of their answers.
_PROBES, _TOLERANCE = 16, 1e-4
#: The activation in a policy file for each torch module; None: the module is left out.
_MODULES = {"ReLU": "relu", "Tanh": "tanh", "Identity": None, "Dropout": None, "Flatten": None}

#: Weights `[outputs, inputs]`, bias `[outputs]`, and activation: "relu", "tanh" or None.
Layer = tuple[ArrayLike, ArrayLike, str | None]
_Layers = list[tuple[NDArray[np.float32], NDArray[np.float32], str]]


class Policy:
    """A policy file that has passed the controller's checks.

    The checks are size, ONNX structure, metadata, observation layout, operators, shapes,
    finite weights and the file's probe answers; `ValueError` gives the reason if one fails.
    Networks of Linear, ReLU and Tanh run natively; others need the library of ONNX Runtime
    (`pip install onnxruntime`, or pass its file or folder as `onnxruntime`).

    >>> policy = Policy("ppl-50000.onnx")
    >>> policy(np.zeros(259, np.float32)).shape
    (2,)
    """

    def __init__(
        self, source: str | os.PathLike[str] | bytes, onnxruntime: str | os.PathLike[str] = ""
    ) -> None:
        #: The file's bytes.
        self.bytes = source if isinstance(source, bytes) else Path(source).read_bytes()
        self._library = str(onnxruntime) or _installed_library()
        self._file = _vlaps.PolicyFile(self.bytes, self._library)
        #: SHA-256 of the file, 64 hexadecimal digits.
        self.sha256: str = self._file.sha256
        #: "native" or "onnxruntime".
        self.runtime = "native" if self._file.is_native else "onnxruntime"
        #: Number of probes in the file.
        self.probes: int = self._file.probes
        origin = self._file.origin
        #: "algorithm", "seed", "steps" and "commit"; None for a plain ONNX file.
        self.origin: dict[str, Any] | None = (
            None if origin is None else dict(zip(("algorithm", "seed", "steps", "commit"), origin))
        )

    def __call__(self, observation: ArrayLike) -> NDArray[np.float32]:
        """The action `[2]` for an observation `[259]`, or `[count, 2]` for `[count, 259]`."""
        rows = np.ascontiguousarray(observation, np.float32)
        if rows.ndim not in (1, 2):
            raise ValueError(f"observation has the shape {rows.shape}: it must be ({FEATURES},) or (count, {FEATURES})")
        if not np.isfinite(rows).all():
            raise ValueError("the observation contains a number that is not finite")
        actions = self._file.infer(np.atleast_2d(rows))
        return actions[0] if rows.ndim == 1 else actions

    @staticmethod
    def refusal(source: str | os.PathLike[str] | bytes) -> str | None:
        """The reason why a file is refused; None if it passes every check."""
        try:
            Policy(source)
        except ValueError as error:
            return str(error)
        return None

    def __reduce__(self) -> tuple[Any, ...]:
        return Policy, (self.bytes, self._library)

    def __repr__(self) -> str:
        return f"<vlaps.Policy {self.sha256[:16]} {self.runtime} {self.origin or 'plain ONNX'}>"


def _installed_library() -> str:
    """The folder of the onnxruntime package's library; empty for the controller's defaults."""
    found = importlib.util.find_spec("onnxruntime")
    if found is None or found.origin is None:
        return ""
    return str(Path(found.origin).parent / "capi")


def export(
    policy: Any,
    path: str | os.PathLike[str],
    *,
    algorithm: str | None = None,
    seed: int | None = None,
    steps: int | None = None,
    commit: str = "",
    mean: ArrayLike | None = None,
    std: ArrayLike | None = None,
) -> Policy:
    """Writes a policy file, checks it, and returns it.

    `policy` is a list of layers `(weights, bias, activation)`, a torch module of Linear,
    ReLU and Tanh (such as a Sequential), or a model or policy of Stable-Baselines3 (PPO,
    A2C, SAC, TD3). Its input are 259 numbers, its output two: steering and pedal, which the
    driver clamps to [-1, 1]. If the observations were normalised in training, as
    `(observation - mean) / std`, pass `mean` and `std` `[259]`: the first layer then
    includes the normalisation. `algorithm`, `seed`, `steps` (driven in training) and
    `commit` are recorded in the file.

    Raises `ValueError` if an answer of the file differs from that of the module or model by
    more than 1e-4, as when a module runs its layers in another order than it lists them.
    """
    path = Path(path)
    if path.suffix != ".onnx":
        raise ValueError(f"{path}: the name of a policy file ends in .onnx")
    layers, answer = _layers_of(policy)
    probes = np.random.default_rng(0).random((_PROBES, FEATURES), np.float32)
    seen = probes
    if mean is not None or std is not None:
        shift = np.broadcast_to(np.asarray(0.0 if mean is None else mean, np.float64), FEATURES)
        scale = np.broadcast_to(np.asarray(1.0 if std is None else std, np.float64), FEATURES)
        layers = _normalised(layers, shift, scale)
        seen = ((probes - shift) / scale).astype(np.float32)
    origin = (
        algorithm if algorithm is not None else type(policy).__name__.lower(),
        int(seed if seed is not None else getattr(policy, "seed", None) or 0),
        int(steps if steps is not None else getattr(policy, "num_timesteps", 0)),
        commit,
    )
    written = Policy(_vlaps.encode_policy(layers, origin, probes))
    if answer is not None:
        expected = np.clip(np.asarray(answer(seen), np.float32), -1.0, 1.0)
        off = float(np.abs(written(probes) - expected).max())
        if not off <= _TOLERANCE:
            raise ValueError(
                f"the file's answers differ by {off:.2g} from those of the policy: the policy does "
                "not run its Linear, ReLU and Tanh modules in the order in which it lists them"
            )
    path.write_bytes(written.bytes)
    return written


def _normalised(layers: _Layers, mean: NDArray[np.float64], std: NDArray[np.float64]) -> _Layers:
    """The layers, with `(x - mean) / std` included in the first one."""
    if not ((std > 0.0).all() and np.isfinite(std).all() and np.isfinite(mean).all()):
        raise ValueError("mean and std must be finite, and std positive")
    weights, bias, activation = layers[0]
    scaled = weights.astype(np.float64) / std
    shifted = bias - scaled @ mean
    return [(scaled.astype(np.float32), shifted.astype(np.float32), activation), *layers[1:]]


def _layers_of(policy: Any) -> tuple[_Layers, Callable[[Any], Any] | None]:
    """The layers of a policy, and the policy as a function if it can be called."""
    if isinstance(policy, Sequence):
        if any(not isinstance(layer, Sequence) or len(layer) != 3 for layer in policy):
            raise TypeError("a layer is (weights, bias, activation)")
        return [_layer(*layer) for layer in policy], None
    if hasattr(policy, "policy") and hasattr(policy, "predict"):
        policy = policy.policy
    if hasattr(policy, "predict"):
        return _chain(_sb3_modules(policy)), lambda seen: policy.predict(seen, deterministic=True)[0]
    if hasattr(policy, "named_parameters"):
        return _chain(_leaves(policy)), torch_driver(policy)
    raise TypeError(
        f"a {type(policy).__name__} cannot be exported: pass a list of (weights, bias, "
        "activation), a torch module, or a model of Stable-Baselines3"
    )


def torch_driver(module: Any) -> Callable[[Any], NDArray[np.float32]]:
    """A torch module as a function of arrays."""
    torch: Any = sys.modules["torch"]
    device = next(module.parameters()).device

    def answer(observations: Any) -> NDArray[np.float32]:
        was_training = module.training
        module.eval()
        with torch.no_grad():
            answered = module(torch.as_tensor(observations, dtype=torch.float32, device=device))
        module.train(was_training)
        actions: NDArray[np.float32] = answered.cpu().numpy()
        return actions

    return answer


def _layer(weights: ArrayLike, bias: ArrayLike, activation: str | None) -> Any:
    matrix = np.ascontiguousarray(weights, np.float32)
    vector = np.ascontiguousarray(bias, np.float32)
    if matrix.ndim != 2 or vector.ndim != 1:
        raise ValueError(
            f"a layer has weights {matrix.shape} and bias {vector.shape}: they must be "
            "(outputs, inputs) and (outputs,)"
        )
    return matrix, vector, activation or ""


def _leaves(module: Any) -> list[Any]:
    """The modules without children, in the order in which they are listed."""
    children = list(module.children())
    return [leaf for child in children for leaf in _leaves(child)] if children else [module]


def _sb3_modules(policy: Any) -> list[Any]:
    """The modules of a Stable-Baselines3 policy from observation to action."""
    if hasattr(policy, "mlp_extractor"):
        return [*_leaves(policy.mlp_extractor.policy_net), policy.action_net]
    actor: Any = getattr(policy, "actor", None)
    if hasattr(actor, "latent_pi"):
        return [*_leaves(actor.latent_pi), actor.mu, "Tanh"]
    if hasattr(actor, "mu"):
        return _leaves(actor.mu)
    raise TypeError(f"a {type(policy).__name__} has no actor of Linear, ReLU and Tanh")


def _chain(modules: list[Any]) -> _Layers:
    """The layers of a chain of modules: each Linear with the activation that follows it."""
    layers: list[list[Any]] = []
    for module in modules:
        kind = module if isinstance(module, str) else type(module).__name__
        if kind == "Linear":
            weights = module.weight.detach().cpu().numpy()
            bias = np.zeros(len(weights)) if module.bias is None else module.bias.detach().cpu().numpy()
            layers.append([weights, bias, None])
        elif kind not in _MODULES:
            raise TypeError(f"a policy file cannot hold {kind}: use Linear, ReLU and Tanh")
        elif _MODULES[kind] is not None:
            if not layers or layers[-1][2] is not None:
                raise TypeError(f"{kind} must follow a Linear module")
            layers[-1][2] = _MODULES[kind]
    return [_layer(*layer) for layer in layers]
