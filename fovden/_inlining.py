"""How Numba compiles a function that is only copied into others: to intermediate code, once, and no further.

Left alone, Numba optimises such a function, all that it calls within it, makes machine code of both and looks up its
address, although nobody will call it; the kernel that has the copy then begins again. On the way to a first frame that
is an eighth of the time.
"""

from __future__ import annotations

from typing import Any

from llvmlite.binding import ModuleRef
from numba import _dynfunc
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import register_pass
from numba.core.typed_passes import NativeLowering

__all__ = ["InliningCompiler"]


class InliningCompiler(CompilerBase):  # type: ignore[misc]  # Numba has no types
    """The pipeline of ``numba.njit`` without what comes after a function's translation to LLVM's code.

    It is for functions with ``forceinline``, without a wrapper for Python, and without a cache: a kernel on the disk
    has its copy.
    """

    def define_pipelines(self) -> list[Any]:
        """Returns the passes; called by Numba."""
        passes = DefaultPassBuilder.define_nopython_pipeline(self.state)
        passes.passes = [(_Lowering if each is NativeLowering else each, text) for each, text in passes.passes]
        passes.finalize()
        return [passes]


class _Copied(JITCodeLibrary):  # type: ignore[misc]
    """Code that has no address. It is optimised where it is copied to."""

    def _optimize_functions(self, module: ModuleRef) -> None:
        module.data_layout = self._codegen._data_layout

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._verify_declare_only_symbols()
        self._finalized = True


@register_pass(mutates_CFG=True, analysis_only=False)
class _Lowering(NativeLowering):  # type: ignore[misc]
    """Translates into a library of the kind above, and tells Numba where callers find it."""

    _name = "lowering_of_what_is_inlined"

    def run_pass(self, state: Any) -> bool:
        """Does so; called by Numba."""
        state.library = _Copied(state.targetctx.codegen(), state.func_id.func_qualname)
        state.flags.no_compile = True
        super().run_pass(state)
        lowered, descriptor = state["cr"], state["cr"].fndesc
        # Callers look the library up by this object, which stands for the function and is never called.
        name, address = descriptor.qualname, 0
        handle = _dynfunc.make_function(descriptor.lookup_module(), name, "", address, lowered.env, (state.library,))
        state.targetctx.insert_user_function(handle, descriptor, [state.library])
        state["cr"] = lowered._replace(cfunc=handle)
        return True
