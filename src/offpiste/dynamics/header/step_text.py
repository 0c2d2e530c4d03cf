"""One step of a model as C: its struct of parameters, the order of physics and networks, and the same backwards."""

from collections.abc import Sequence
from importlib.resources import files

from offpiste.dynamics.base import Dynamics
from offpiste.dynamics.header.networks import LANE, network_text
from offpiste.dynamics.kernels import layout
from offpiste.dynamics.kernels.networks import ModelNetwork, absent_actuators, model_networks, units

LANES = 4
"""Threads that share a step, a unit of each LSTM and a wheel for each: OFFPISTE_LANES in `lanes.h`."""

MOVED = len(layout.STEPPED)
NEXT = layout.ROW[layout.NEXT[0]]


def shipped_text(name: str) -> str:
    """Text of a file beside this one."""
    return files(__package__).joinpath(name).read_text("utf-8")


def step_text(dynamics: Dynamics, *, adjoint: bool = False, apart: bool = False, lanes: bool = False) -> str:
    """C code of one step of a model, without its weights.

    Args:
        adjoint: also `offpiste_step_adjoint`.
        apart: whether what codes add to the first network is given instead of the codes (`terms_of_codes`).
        lanes: whether `LANES` threads share a step (`lanes.h`); neither back nor apart.

    Raises:
        ValueError: kernels cannot step the model.
    """
    networks = model_networks(dynamics, apart=apart)
    assert not lanes or layout.HIDDEN == LANES, "a lane has one unit of an LSTM"
    parts = [shipped_text(name) for name in ("elementary.h", *(["lanes.h"] if lanes else []), "physics.h")]
    parts += [network_text(network, shipped_text("network_lanes.h" if lanes else "network.h")) for network in networks]
    parts += [_declarations(dynamics, networks, apart), _see(dynamics), _step(dynamics, networks)]
    parts += [_arranged(networks)] if lanes else []
    if adjoint:
        parts += [shipped_text("physics_adjoint.h")]
        parts += [network_text(network, shipped_text("network_adjoint.h")) for network in networks]
        parts += [_adjoint(dynamics, networks)]
    guard = "OFFPISTE_STEP_H"
    return f"#ifndef {guard}\n#define {guard}\n\n" + "\n".join(parts) + f"\n#endif /* {guard} */\n"


def _arranged(networks: Sequence[ModelNetwork]) -> str:
    """Return the C code that puts weights in the order in which lanes read them."""
    gates = [f"p->{of.name}.gates" for of in networks]
    body = [f"    offpiste_by_unit({name}[0], sizeof({name}) / sizeof({name}[0]), first, apart);" for name in gates]
    head = "OFFPISTE_FN void offpiste_arrange(offpiste_params* p, int first, int apart) {"
    return "\n".join((head, "    (void)p; (void)first; (void)apart;", *body, "}\n"))


def term_count(dynamics: Dynamics) -> int:
    """Numbers that `terms_of_codes` adds."""
    first = next((network for network in model_networks(dynamics) if network.name == "force"), None)
    return 4 * layout.HIDDEN + first.width if first and dynamics.codes else 0


def _declarations(dynamics: Dynamics, networks: Sequence[ModelNetwork], apart: bool) -> str:
    count, codes = units(dynamics), 0 if apart else 4 * dynamics.codes
    sizes = {
        "STATE": MOVED + 2 * count,
        "UNITS": count,
        "CONTROLS": len(dynamics.vehicle.control_columns),
        "CODES": codes,
        "TERMS": term_count(dynamics) if apart else 0,
        "CONSTANTS": len(layout.LEARNED),
        "ROWS": len(layout.ROWS),
        "ABSENT": sum(1 << row for row in absent_actuators(dynamics.vehicle)),
    }
    for network in networks[:1]:
        if network.name == "force":
            sizes |= {"FORCE_INPUTS": len(network.inputs), "FORCE_WIDTH": network.width}
    constants = len(layout.CONSTANTS) + -len(layout.CONSTANTS) % LANE
    lines = [f"#define OFFPISTE_{name} {value}" for name, value in sizes.items()]
    lines += ["", "/* Bit k of OFFPISTE_ABSENT: number k of a state was never measured. */"]
    lines += ["", "/* Everything that is learned. */", "typedef struct {"]
    lines += [f"    offpiste_scalar constants[{constants}];"]
    lines += [f"    offpiste_{network.name}_network {network.name};" for network in networks]
    given = ["control[OFFPISTE_CONTROLS]", "normal[3]", "unknown"]
    given += ["codes[OFFPISTE_CODES]"] if codes else []
    given += ["terms[OFFPISTE_TERMS]"] if sizes["TERMS"] else []
    controls = ", ".join(dynamics.vehicle.control_columns)
    lines += [
        "} offpiste_params;",
        "",
        f"/* What a step reads. control: {controls}; normal: mean of the unit normals under the four wheels,",
        "   world frame, straight up where unknown; unknown: share of wheels whose normal is; codes: of the wheels. */",
        "typedef struct {",
        f"    offpiste_real {', '.join(given)};",
        "} offpiste_given;",
        "",
        "/* What a step computes; the adjoint reads it. */",
        "typedef struct {",
        "    offpiste_real w[OFFPISTE_ROWS];",
        *(f"    offpiste_{network.name}_activations {network.name};" for network in networks),
        "} offpiste_activations;",
        "",
    ]
    return "\n".join(lines)


def _read(row: int) -> str:
    """Return the C expression of an input of a network: a row of the workspace, or a code."""
    return f"w[{row}]" if row < len(layout.ROWS) else f"given->codes[{row - len(layout.ROWS)}]"


def _see(dynamics: Dynamics) -> str:
    """Return the C code that fills the workspace for networks and physics from a state and the given inputs."""
    vehicle = dynamics.vehicle
    absent = absent_actuators(dynamics.vehicle)
    body = [f"w[{row}] = {'zero' if row in absent else f'state[{row}]'};" for row in range(MOVED)]
    for name, row, stands in zip(layout.COMMANDS, layout.CONTROLS, layout.ABSENT, strict=True):
        if name in vehicle.control:
            body.append(f"w[{layout.ROW[row]}] = given->control[{vehicle.control_columns.index(name)}];")
        else:
            body.append(f"w[{layout.ROW[row]}] = zero + {float(stands)}f;")
    body += [f"w[{layout.ROW[row]}] = given->normal[{k}];" for k, row in enumerate(layout.NORMAL)]
    body += [f"w[{layout.ROW[layout.UNKNOWN[0]]}] = given->unknown;", "offpiste_sense(w, params->constants);"]
    zero = ["const offpiste_real zero = {0.0f};"] if any("zero" in line for line in body) else []
    head = (
        "/* What networks and physics read. */\n"
        "OFFPISTE_FN void offpiste_see(\n    const offpiste_params* params, const offpiste_given* given, "
        "const offpiste_real* state, offpiste_real* w) {"
    )
    return "\n    ".join((head, *zero, *body)) + "\n}\n"


def inputs_text(of: ModelNetwork) -> str:
    """Return the line of C code that gathers the inputs of a network."""
    return f"const offpiste_real {of.name}_inputs[] = {{{', '.join(map(_read, of.inputs))}}};"


def _step(dynamics: Dynamics, networks: Sequence[ModelNetwork]) -> str:
    count, absent = units(dynamics), absent_actuators(dynamics.vehicle)
    corrected = {row for of in networks for row in range(of.first_output, of.first_output + of.outputs)}
    left = [name for name in (*layout.CORRECTION, *layout.RESIDUALS) if layout.ROW[name] not in corrected]
    body = ["const offpiste_real zero = {0.0f};"] if left else []
    body += ["offpiste_real* w = a->w;", "offpiste_see(params, given, state, w);"]
    body += [f"w[{layout.ROW[name]}] = zero;" for name in left]
    for number, of in enumerate(networks):
        hidden = MOVED + layout.HIDDEN * number
        body += [
            inputs_text(of),
            f"offpiste_{of.name}_step(&params->{of.name}, {of.name}_inputs, {'given->terms' if of.terms else '0'},",
            f"    state + {hidden}, state + {hidden + count}, &a->{of.name});",
            *(f"w[{of.first_output + k}] = a->{of.name}.outputs[{k}];" for k in range(of.outputs)),
        ]
    body.append("offpiste_advance(w, params->constants);")
    body += [f"state[{row}] = w[{NEXT + row}];" for row in range(MOVED) if row not in absent]
    columns = ", ".join(dynamics.vehicle.control_columns)
    gear = ", which is -1 (reverse), 0 (neutral) or 1 (forward)" if "gear" in dynamics.vehicle.control_columns else ""
    head = (
        f"/* One step of 0.02 s. state: {', '.join(layout.STEPPED)}; then hidden units and cells of the networks.\n"
        "   SI units and radians; vx, vy: horizontal world velocity turned by minus yaw; engine in 1000 rev/min.\n"
        f"   given->control: {columns}{gear}.\n"
        "   Slots of absent actuators are left alone. */\n"
        "OFFPISTE_FN void offpiste_step_kept(\n"
        "    const offpiste_params* params, const offpiste_given* given, offpiste_real* state,\n"
        "    offpiste_activations* a) {"
    )
    return "\n    ".join((head, *body)) + (
        "\n}\n\nOFFPISTE_FN void offpiste_step(\n"
        "    const offpiste_params* params, const offpiste_given* given, offpiste_real* state) {\n"
        "    offpiste_activations a;\n"
        "    offpiste_step_kept(params, given, state, &a);\n}\n"
    )


def _adjoint(dynamics: Dynamics, networks: Sequence[ModelNetwork]) -> str:
    count, first_code = units(dynamics), len(layout.ROWS)
    lines = [
        "/* bar->codes: adjoint of the codes; of each network, see its adjoints. */",
        "typedef struct {",
        *(f"    offpiste_{of.name}_adjoints {of.name};" for of in networks),
        "    offpiste_real w[OFFPISTE_ROWS];",
        "} offpiste_adjoints;",
        "",
        "/* state_bar: of the state after the step, and then before it. c_bar: of the learned constants, added to. */",
        "OFFPISTE_FN void offpiste_step_adjoint(",
        "    const offpiste_params* params, const offpiste_activations* a, offpiste_real* state_bar,",
        "    offpiste_real* c_bar, offpiste_adjoints* bar) {",
    ]
    body = [
        "const offpiste_real zero = {0.0f};",
        "offpiste_real* w_bar = bar->w;",
        "OFFPISTE_UNROLL",
        "for (int k = 0; k < OFFPISTE_ROWS; k++) w_bar[k] = zero;",
        *(f"w_bar[{NEXT + row}] = state_bar[{row}];" for row in range(MOVED)),
        "offpiste_advance_adjoint(a->w, params->constants, w_bar, c_bar);",
    ]
    for number, of in enumerate(networks):
        hidden = MOVED + layout.HIDDEN * number
        body += [
            f"offpiste_{of.name}_adjoint(&params->{of.name}, &a->{of.name}, w_bar + {of.first_output},",
            f"    state_bar + {hidden}, state_bar + {hidden + count}, &bar->{of.name});",
            *(f"w_bar[{row}] += bar->{of.name}.inputs[{k}];" for k, row in enumerate(of.inputs) if row < first_code),
        ]
    body.append("offpiste_sense_adjoint(a->w, params->constants, w_bar, c_bar);")
    body += [f"state_bar[{row}] = w_bar[{row}];" for row in range(MOVED)]
    return "\n".join(lines) + "\n    " + "\n    ".join(body) + "\n}\n"
