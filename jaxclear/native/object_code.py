"""From LLVM code to machine code in this process, which other processes may find on disk.

What is kept is the object code that LLVM makes of a text, under a key of that text, the processor
and LLVM's version. Places in memory are filled in as it is loaded: that of the flag which stops all
kernels, and those of C's functions.
"""

import functools
from typing import Any

from jaxclear.ground import cache_folder
from jaxclear.native import stopping

# How much LLVM optimises each function of a kernel, from 0 (not) to 3. Its pipeline for whole
# modules takes twice as long and makes the same code, as does level 2.
SPEED_LEVEL = 1
# How much LLVM optimises while it chooses and arranges instructions, from 0 to 3. At 0, and without
# passes before that, the start of a robot with closed loops is code in a fiftieth of the time, and
# takes some three times as long, which is milliseconds.
CODE_LEVEL, CODE_LEVEL_ONCE = 3, 0


def compiled(text: str) -> Any:
    """An engine that holds the machine code; the code lives as long as it does."""
    import llvmlite.binding as llvm

    return _load_object(llvm.ObjectFileRef.from_data(_compile_to_object(text)))


def load_or_compile(text: str, is_run_once: bool = False) -> tuple[Any, str]:
    """As `compiled`, from disk where it is there; and the key under which it is there from now
    on. What runs once is not optimised; its text tells that by its name."""
    key = cache_folder.key_of(text, processor())
    engine = from_disk(key)
    if engine is not None:
        return engine, key
    import llvmlite.binding as llvm

    code = _compile_to_object(text, is_run_once)
    cache_folder.write(cache_folder.KERNEL, key, code)
    return _load_object(llvm.ObjectFileRef.from_data(code)), key


def from_disk(key: str) -> Any:
    """An engine that holds what is kept under a key; None where nothing is."""
    import llvmlite.binding as llvm

    code = cache_folder.read(cache_folder.KERNEL, key)
    return None if code is None else _load_object(llvm.ObjectFileRef.from_data(code))


def _compile_to_object(text: str, is_run_once: bool = False) -> bytes:
    import llvmlite.binding as llvm

    machine = _target_machine(CODE_LEVEL_ONCE if is_run_once else CODE_LEVEL)
    module = llvm.parse_assembly(text)
    if SPEED_LEVEL and not is_run_once:
        optimise(module, machine)
    return machine.emit_object(module)


def optimise(module: Any, machine: Any) -> None:
    """Inlines the elementary functions, then simplifies each function by itself."""
    import llvmlite.binding as llvm

    options = llvm.create_pipeline_tuning_options(speed_level=SPEED_LEVEL)
    passes = llvm.create_pass_builder(machine, options)
    for function in module.functions:
        if function.name.startswith("jc."):
            function.add_function_attribute("alwaysinline")
    inliner = llvm.create_new_module_pass_manager()
    inliner.add_always_inliner_pass()
    inliner.run(module, passes)
    simplification = passes.getFunctionPassManager()
    for function in module.functions:
        if not function.is_declaration:
            simplification.run(function, passes)


def _load_object(code: Any) -> Any:
    import llvmlite.binding as llvm

    machine = _target_machine()
    stopping.place_flag()
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine)
    engine.add_object_file(code)
    engine.finalize_object()
    return engine


@functools.cache
def processor() -> str:
    """The processor, and who writes code for it."""
    import llvmlite
    import llvmlite.binding as llvm

    llvm.initialize_native_target()
    name, features = llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten()
    numbers = llvmlite.__version__, *llvm.llvm_version_info
    return f"{llvm.get_process_triple()} {name} {features} {numbers}"


def _target_machine(level: int = CODE_LEVEL) -> Any:
    """LLVM's description of this processor; an engine takes it over, so each needs its own."""
    import llvmlite.binding as llvm

    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    features = llvm.get_host_cpu_features().flatten()
    target = llvm.Target.from_default_triple()
    return target.create_target_machine(
        opt=level, cpu=llvm.get_host_cpu_name(), features=features, jit=True
    )
