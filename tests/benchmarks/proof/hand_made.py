"""Labels and answers made by hand, for the tests of the judge."""

FS_HZ = 1000.0
NOISE_UM = 0.01


def effect(name: str, severity: float = 10.0, **more: object) -> dict:
    return {
        "name": name,
        "listed": True,
        "severity": severity,
        "severity_beyond_plays": severity / 2,
        "parameters": {},
        "form": "a form",
    } | more


def labels(*effects: dict, **more: object) -> dict:
    return {
        "track": "alien",
        "case": "case_0001",
        "fs_hz": FS_HZ,
        "timing": "end_of_hold",
        "family": "pi",
        "noise_rms_um": NOISE_UM,
        "names": [e["name"] for e in effects if e["listed"]],
        "unknown": [e["name"] for e in effects if not e["listed"]],
        "tolerated": [],
        "effects": list(effects),
    } | more


def named(name: str, *alternatives: str, probability: float | None = 0.9, **parameters: dict) -> dict:
    return {
        "name": name,
        "alternatives": list(alternatives),
        "probability": probability,
        "parameters": parameters,
        "share": 1.0,
    }


def answer(*effects: dict, verdict: str = "explained", heldout_um: tuple[float, float] = (1.0, 0.5)) -> dict:
    fit = {
        key: {"heldout_rms_um": rms} for key, rms in zip(("retuned", "augmented"), heldout_um, strict=True)
    }
    return {"verdict": verdict, "effects": list(effects), "fit": fit | {"noise_floor_um": None}}


def value(number: float, unit: str, interval: list[float] | None = None) -> dict:
    return {"value": number, "unit": unit} | ({} if interval is None else {"interval_90": interval})
