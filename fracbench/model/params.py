"""The parameters of the methods: one typed, validated record, with the meaning and the range of each."""

import dataclasses
import math
import types
import typing
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal, Self

from fracbench.errors import InputError, unknown_name


@dataclass(frozen=True)
class ParamInfo:
    """The meaning and the range of a parameter.

    Attributes
    ----------
    text : str
        One line.
    symbol : str
        The paper's symbol, LaTeX; empty if the paper has none.
    paper_range : str
        The range of Table 1, or the paper's words; empty if it says nothing.
    low, high : float
        Bounds, both allowed unless `open_low`.
    open_low : bool
        Whether `low` itself is excluded.
    """

    text: str
    symbol: str = ""
    paper_range: str = ""
    low: float = -math.inf
    high: float = math.inf
    open_low: bool = False


def _param(default: Any, text: str, symbol: str = "", paper_range: str = "", **bounds: Any) -> Any:
    info = ParamInfo(text, symbol, paper_range, **bounds)
    return dataclasses.field(default=default, metadata={"info": info})


def _switch(default: Any, text: str, **bounds: Any) -> Any:
    """Return a field of a switch: a parameter that came after results were stored and is off at its default."""
    info = ParamInfo(text, **bounds)
    return dataclasses.field(default=default, metadata={"info": info, "switch": True})


@dataclass(frozen=True, kw_only=True)
class FlowParams:
    """Parameters of a flow computation; the defaults are the preset `recommended`.

    The defaults of `alpha_flat`, `alpha_edge`, `alpha_corner` and `alpha_texture` are the setting of
    ``experiments/adaptive_alpha.yaml`` with the least mean AEPE on Middlebury's eight sequences, by a small margin
    over one alpha for all (docs/beyond.md).

    The metadata of each field hold its meaning, symbol and range (`FlowParams.info`); ``fracbench table 1``
    prints them. In configurations and on the command line `lambda_` is called ``lambda``.

    Raises
    ------
    InputError
        A value of the wrong type or outside its range.
    """

    # fmt: off
    lambda_: float = _param(0.3, "data attachment weight, for intensities in 0..255", r"\lambda", "[0.1, 1]",
                            low=0.0, open_low=True)
    theta: float = _param(0.3, "tightness of the coupling of u and v", r"\theta", "[0.1, 1]",
                          low=0.0, open_low=True)
    lambda_sb: float = _param(10.0, "split Bregman penalty", r"\lambda_{SB}", "[1, 10]", low=0.0, open_low=True)
    alpha: float = _param(1.1, "order of the fractional gradient; of the paper's method at most 2", r"\alpha",
                          "[0, 2]", low=0.0, high=4.0)
    epsilon: float = _param(0.01, "stopping threshold on the change of the flow, pixels", r"\epsilon", "0.01",
                            low=0.0)
    eta: float = _param(0.5, "downsampling factor of the pyramid", r"\eta", "0.5", low=0.1, high=0.95)
    n_scales: int | None = _param(None, "number of scales; auto: as many as the image allows", r"N_{scales}",
                                  "[3, 5] (Table 2: 4 to 6)", low=1)
    finest_scale: int = _param(0, "finest scale that is computed; its flow is upsampled; 0: the frames themselves",
                               paper_range="(0)", low=0)
    n_warps: int = _param(4, "number of warps (linearisations) per scale", r"N_{warps}", "[3, 5]", low=1)
    max_iter: int = _param(6, "largest number of iterations per warp", r"N_{maxitr}", "not given", low=1)
    presmoothing: float = _param(0.6, "standard deviation of the Gaussian on both frames, pixels",
                                 r"\sigma_0", "0.6", low=0.0, high=100.0)
    boundary: Literal["zero", "reflect"] = _param(
        "reflect", "u outside the image: 0, or the mirror image of u inside", paper_range="zero (Dirichlet)")
    pad: int = _param(0, "padding around the image under boundary=zero, pixels",
                      paper_range="'padding around the image', not given", low=0, high=1000)
    u_solver: Literal["exact", "gauss_seidel", "jacobi"] = _param(
        "exact", "solver of the u-step", paper_range="fixed-point sweep")
    inner: Literal["warm", "cold"] = _param(
        "warm", "start of the split Bregman iteration: the state of the last call, or zeros", paper_range="cold")
    coupling: Literal["multiplier", "penalty"] = _param(
        "multiplier", "coupling of v- and u-step: the multiplier of ADMM, or the paper's penalty alone",
        paper_range="penalty")
    coupling_step: float = _param(3.0, "inverse penalty of coupling=multiplier", paper_range="(theta)",
                                  low=0.0, open_low=True)
    relaxation: float = _param(1.7, "over-relaxation of coupling=multiplier; 1: none", paper_range="(1)",
                               low=1.0, high=1.9)
    tol: float = _param(0.01, "stopping threshold of the cold inner loop, pixels", "TOL", "not given", low=0.0)
    max_inner: int = _param(30, "largest number of cold inner iterations", paper_range="not given", low=1)
    tau: float = _param(0.25, "time step of the dual method", low=0.0, high=0.25, open_low=True)
    upsample_gain: float | None = _param(
        None, "factor on the flow carried to the next scale; none: the ratio of the sizes",
        paper_range="1/eta, sampled at x/eta", low=0.0, high=10.0)
    relinearise: bool = _param(True, "linearise at u0 = u in each warp; false: at u0 = 0 throughout, as printed",
                               paper_range="not stated")
    dual_restart: bool = _param(False, "reset dual or Bregman variables at each warp", paper_range="not stated")
    gradient_scale: float = _param(1.0, "factor on the image gradient", low=0.0, open_low=True)
    epsilon_squared: bool = _param(True, "compare the mean squared change with epsilon^2; false: with epsilon",
                                   paper_range="both are printed")
    dtype: Literal["float32", "float64"] = _param("float32", "precision of the computation")
    alpha_flat: float = _param(1.0, "order where frame 0 is flat", low=0.0, high=4.0)
    alpha_edge: float = _param(1.1, "order where frame 0 has an edge", low=0.0, high=4.0)
    alpha_corner: float = _param(1.1, "order where frame 0 has a corner", low=0.0, high=4.0)
    alpha_texture: float = _param(1.2, "order where frame 0 is textured", low=0.0, high=4.0)
    lambda_gradient: float = _param(0.0, "data attachment weight of each image derivative; 0: brightness alone",
                                    low=0.0)
    derivatives: Literal["frame1", "both"] = _param(
        "frame1", "image derivatives: central ones of frame 1, or the mean of five-point ones of both frames")
    edge_decay: float = _param(
        0.0, "k in the weights exp(-k g^b) of the regulariser, g = |gradient of frame 0|; 0: none", low=0.0)
    edge_power: float = _param(0.5, "b in the weights exp(-k g^b)", low=0.0, high=4.0, open_low=True)
    median_radius: int = _param(
        0, "radius of the median filter of the flow after each warp, pixels; 0: none", low=0, high=10)
    weighted_radius: int = _param(
        0, "radius of the weighted median near motion edges after each warp, pixels; 0: none", low=0, high=20)
    texture: float = _param(0.0, "share of the frames' structure that the data term leaves out; 0: none",
                            low=0.0, high=1.0)
    occlusion: Literal["median", "none", "both"] = _param(
        "median", "weighting by visibility: of neighbours in the weighted median, or of these and of the data")
    normalisation: float = _param(
        0.0, "standard deviation of the window whose mean and contrast normalise the frames, pixels; 0: none",
        low=0.0, high=100.0)
    alpha_smooth: float = _param(1.5, "order of the second part q of the flow u = p + q; alpha is that of p",
                                 low=0.0, high=4.0)
    smooth_weight: float = _param(2.0, "weight of the second part's regularity", low=0.0, open_low=True)
    smooth_penalty: float = _param(1.0, "split Bregman penalty of the second part, as a multiple of lambda_sb",
                                   low=0.0, open_low=True)
    lambda_growth: float = _param(
        0.0, "g in lambda r^g, the weight of the data on a scale whose sides are 1/r of the frames'; 0: lambda",
        low=0.0, high=4.0)
    weighted_guide: Literal["gray", "color"] = _param(
        "gray", "guide of the weighted median: the gray levels of frame 0, or its colour in CIE Lab")

    # Other readings of Algorithms 1 to 4 (docs/switches.md): each is off at its default.
    intensity: Literal["joint", "each", "unit", "given"] = _switch(
        "joint", "range of the frames: 0..255 together, 0..255 each by itself, 0..1 together, or as they are")
    lambda_factor: float = _switch(1.0, "factor on lambda", low=0.0, open_low=True)
    theta_factor: float = _switch(1.0, "factor on theta", low=0.0, open_low=True)
    swap_weights: bool = _switch(False, "exchange lambda and theta, before their factors")
    smoothing_at: Literal["frames", "scales"] = _switch(
        "frames", "presmoothing of the frames before the pyramid is built, or of each scale after it")
    downsampling: Literal["gaussian", "plain", "imresize", "gaussian_imresize", "area"] = _switch(
        "gaussian", "scales of the images: smoothed and sampled, sampled alone, by imresize, both, or by areas")
    upsampling: Literal["bicubic", "bilinear", "nearest", "imresize", "printed"] = _switch(
        "bicubic", "interpolation of the coarse flow; printed: sampled at x/eta, 0 outside")
    gradient_of: Literal["frame1", "warped", "still", "frame0", "mean"] = _switch(
        "frame1", "image gradient: of frame 1, then warped; of the warped frame 1; of frame 1 or 0 as it is; "
        "or the mean of frame 0's and the warped one")
    stencil: Literal["central", "forward", "backward", "five_point"] = _switch(
        "central", "differences of the image gradient")
    warp: Literal["bicubic", "bilinear"] = _switch("bicubic", "interpolation of frame 1 and its gradient")
    outside: Literal["zero", "repeat", "frame0", "off"] = _switch(
        "zero", "samples outside frame 1: 0, those of the border, frame 0, or without a data term")
    threshold: Literal["full", "no_theta", "no_square"] = _switch(
        "full", "threshold of the v-step under coupling=penalty: in full, without theta, or without the square")
    u0_per_scale: bool = _switch(False, "linearise in all warps of a scale at the flow it starts from")
    residual_u0: bool = _switch(True, "subtract u0 in the residual; false: I1(x + u0) + grad I1 . u - I0")
    unknown: Literal["flow", "increment"] = _switch(
        "flow", "unknown of a warp: the flow, or its change in this warp, which alone is regularised")
    shrinkage: Literal["isotropic", "anisotropic"] = _switch(
        "isotropic", "shrinkage of the derivatives along x and y: by their norm, or each by itself")
    lambda_l: float | None = _switch(
        None, "penalty in the u-step; none: lambda_sb, the one of the shrinkage", low=0.0, open_low=True)
    sweeps: int = _switch(1, "Gauss-Seidel sweeps of a u-step, or dual steps of TV-L1", low=1)
    sweep_order: Literal["raster", "backward", "at_once"] = _switch(
        "raster", "order of a Gauss-Seidel sweep of the 5-point stencil; at_once: Jacobi's")
    stencil_border: Literal["natural", "four_zero", "four_repeat"] = _switch(
        "natural", "5-point stencil at the border: the neighbours there are, or four, those outside 0 or repeated")
    tol_norm: Literal["rms", "max", "sum", "relative"] = _switch(
        "rms", "norm of a component's change that tol bounds: root mean square, maximum, Euclidean, or relative")
    # fmt: on

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            value = getattr(self, name)
            # Thousands of points share their values; a list, which is never one, cannot be looked up.
            accept = _accepted if isinstance(value, str | float | int | None) else _accepted.__wrapped__
            object.__setattr__(self, name, accept(name, value))

    @classmethod
    def names(cls) -> tuple[str, ...]:
        """Return the parameters' names as configurations and the command line spell them."""
        return tuple(public_name(field.name) for field in dataclasses.fields(cls))

    @classmethod
    def info(cls, name: str) -> ParamInfo:
        """Return the meaning and the range of a parameter, by either of its spellings."""
        return typing.cast(ParamInfo, cls.__dataclass_fields__[_field_name(name)].metadata["info"])

    @classmethod
    def accepted(cls, name: str, value: Any) -> tuple[str, Any]:
        """Return the field of a parameter and a value in its type; `InputError`: the value is out of its range."""
        field = _field_name(name)
        return field, _accepted(field, value)

    def replace(self, changes: Mapping[str, Any], where: str = "") -> Self:
        """Return a copy with some values changed.

        Parameters
        ----------
        changes : mapping
            Values by name (either spelling); strings are converted to the parameter's type.
        where : str, optional
            The source of the values, for error messages.

        Raises
        ------
        InputError
            An unknown name (the nearest is offered), a wrong type, a value outside its range.
        """
        for name in changes:
            if _field_name(name) not in self.__dataclass_fields__:
                raise unknown_name("parameter", name, self.names(), where)
        return dataclasses.replace(self, **{_field_name(name): value for name, value in changes.items()})

    def weighted(self) -> Self:
        """Return the parameters with the lambda and theta that are used: exchanged and multiplied as asked for."""
        if not self.swap_weights and self.lambda_factor == self.theta_factor == 1.0:
            return self
        lambda_, theta = (self.theta, self.lambda_) if self.swap_weights else (self.lambda_, self.theta)
        return dataclasses.replace(
            self,
            lambda_=lambda_ * self.lambda_factor,
            theta=theta * self.theta_factor,
            lambda_factor=1.0,
            theta_factor=1.0,
            swap_weights=False,
        )

    def as_dict(self) -> dict[str, Any]:
        """Return the values by public name."""
        return {public_name(f.name): getattr(self, f.name) for f in dataclasses.fields(self)}


#: The switches' values at which they are off, by public name.
SWITCHES: dict[str, Any] = {
    field.name: field.default for field in dataclasses.fields(FlowParams) if "switch" in field.metadata
}


def public_name(field_name: str) -> str:
    """Return a field's name as configurations spell it: ``lambda`` is a reserved word in Python only."""
    return field_name.rstrip("_")


def _field_name(name: str) -> str:
    return "lambda_" if name == "lambda" else name


@lru_cache(maxsize=4096, typed=True)
def _accepted(name: str, value: Any) -> Any:
    """Return the value of a field in its type, or raise an error that states the allowed values."""
    converted = coerce(name, FlowParams.__dataclass_fields__[name].type, value)
    _check_range(name, FlowParams.info(name), converted)
    return converted


_WORDS = {bool: "true or false", int: "a whole number", float: "a number", str: "a text"}


def coerce(name: str, hint: Any, value: Any) -> Any:
    """Convert `value` (possibly a string) to the annotated type; the error states the allowed values."""
    options = typing.get_args(hint)
    if typing.get_origin(hint) in (types.UnionType, typing.Union):
        if value is None or (isinstance(value, str) and value.lower() in ("none", "null", "auto")):
            return None
        return coerce(name, next(kind for kind in options if kind is not types.NoneType), value)
    if typing.get_origin(hint) is Literal:
        if value not in options:
            raise unknown_name(f"value of `{public_name(name)}`", str(value), options)
        return value
    try:
        return _convert(hint, value)
    except (KeyError, TypeError, ValueError, OverflowError):
        raise InputError(f"`{public_name(name)}` must be {_WORDS[hint]}, got {value!r}") from None


def _convert(kind: type, value: Any) -> Any:
    if kind is bool and isinstance(value, str):
        return {"true": True, "false": False}[value.lower()]
    if isinstance(value, bool) != (kind is bool) or (kind is str and not isinstance(value, str)):
        raise TypeError
    if kind in (bool, str):
        return value
    number = float(value)
    if not math.isfinite(number) or (kind is int and number != int(number)):
        raise ValueError
    return kind(number)


def _check_range(name: str, info: ParamInfo, value: Any) -> None:
    if value is None or isinstance(value, str | bool):
        return
    if value < info.low or value > info.high or (info.open_low and value == info.low):
        allowed = f"in {'(' if info.open_low else '['}{info.low:g}, {info.high:g}]"
        if math.isinf(info.high):
            allowed = f"{'greater than' if info.open_low else 'at least'} {info.low:g}"
        raise InputError(f"`{public_name(name)}` must be {allowed}, got {value:g}")
