"""A wrapped environment where a gymnasium.Env is asked for."""
from __future__ import annotations

from typing import Any

import gymnasium  # type: ignore[import-not-found]
from robostress.wrapping import WrappedEnvironment


class JointErrorsWrapper(WrappedEnvironment, gymnasium.Wrapper, gymnasium.utils.RecordConstructorArgs):
    __doc__ = WrappedEnvironment.__doc__

    def __init__(self, env: Any, scenario: str, **options: Any) -> None:
        gymnasium.utils.RecordConstructorArgs.__init__(self, scenario=scenario, **options)
        gymnasium.Wrapper.__init__(self, env)
        WrappedEnvironment.__init__(self, env, scenario, **options)
