"""Energies as expressions of FEBio, which derives stresses from them (``MObjBuilder``, ``MDerive``)."""

from __future__ import annotations

import ast
import re
from collections.abc import Mapping

from hpcinv.base.quantity.expressions import Expression

LONGEST = 500
"""characters of an expression; FEBio copies it into 512"""
_OPERATORS: Mapping[type[ast.operator], str] = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Pow: "^"}
_FUNCTIONS = {"exp": "exp", "ln": "ln", "log": "ln", "sqrt": "sqrt"}
"""names of FEBio, whose ``log`` is decadic; it cannot derive others twice, or is not known to"""
COUPLED = {"I1_bar": "(I1*J^(-2/3))", "I2_bar": "(I2*J^(-4/3))"}
UNCOUPLED = {"I1_bar": "I1", "I2_bar": "I2"}
"""invariants of hpcinv in expressions; in uncoupled materials of FEBio, I1 and I2 are of C_bar"""
_OF_FIBRES = re.compile(r"(I[45])_\w+")


def febio_expression(energy: Expression, numbers: Mapping[str, float], invariants: Mapping[str, str]) -> str:
    """Return an energy as an expression of FEBio, with its invariants ``I1``, ``I2``, ``I4``, ``I5`` and ``J``.

    Args:
        numbers: parameters by name.
        invariants: as FEBio has them, by names of hpcinv.

    Raises:
        ValueError: FEBio has no such expression; the message is the reason.
    """
    if energy.has_units:
        raise ValueError("its energy has numbers with units; give them as parameters")
    names = dict(invariants) | {name: shown(value) for name, value in numbers.items()}
    for name, text in energy.definitions:
        names[name] = f"({_written(ast.parse(text, mode='eval').body, names)})"
    written = _written(ast.parse(energy.source, mode="eval").body, names)
    if len(written) > LONGEST:
        raise ValueError(f"its energy has {len(written)} characters there, and FEBio reads {LONGEST}")
    return written


def shown(number: float) -> str:
    """Return a number of an expression."""
    return f"{number:.17g}" if number >= 0 else f"(-{-number:.17g})"


def _written(node: ast.AST, names: Mapping[str, str]) -> str:
    match node:
        case ast.BinOp(left, operator, right) if type(operator) in _OPERATORS:
            return f"({_written(left, names)}{_OPERATORS[type(operator)]}{_written(right, names)})"
        case ast.UnaryOp(ast.USub(), operand):
            return f"(-{_written(operand, names)})"
        case ast.Call(ast.Name(name), [argument], []) if name in _FUNCTIONS:
            return f"{_FUNCTIONS[name]}({_written(argument, names)})"
        case ast.Call(ast.Name(name)):
            raise ValueError(f"its energy has '{name}', which FEBio's hyperelastic materials do not derive")
        case ast.Constant(int() | float() as value):
            return shown(float(value))
        case ast.Name(name) if name in names:
            return names[name]
        case ast.Name("I1" | "I2" | "J" as name):
            return name
        case ast.Name(name) if found := _OF_FIBRES.fullmatch(name):
            return found[1]
        case ast.Name(name):
            raise ValueError(f"its energy has '{name}', which FEBio's hyperelastic materials lack")
    raise ValueError(f"its energy has '{ast.unparse(node)}', which FEBio's hyperelastic materials lack")
