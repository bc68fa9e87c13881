"""LLVM text made machine code of this processor."""

from typing import Any


def compiled(text: str) -> Any:
    """An engine that holds the machine code; the code lives as long as it does."""
    import llvmlite.binding as llvm

    module = llvm.parse_assembly(text)
    machine = _target()
    options = llvm.create_pipeline_tuning_options(speed_level=2)
    passes = llvm.create_pass_builder(machine, options)
    passes.getModulePassManager().run(module, passes)
    engine = llvm.create_mcjit_compiler(module, machine)
    engine.finalize_object()
    return engine


def _target() -> Any:
    """LLVM's description of this processor; an engine takes it over, so each needs its own."""
    import llvmlite.binding as llvm

    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    features = llvm.get_host_cpu_features().flatten()
    target = llvm.Target.from_default_triple()
    return target.create_target_machine(
        opt=3, cpu=llvm.get_host_cpu_name(), features=features, jit=True
    )


def widest() -> int:
    """Samples that one vector register of this processor holds, twice over where registers are
    short.
    """
    import llvmlite.binding as llvm

    return 8 if llvm.get_host_cpu_features().get("avx512f") else 4
