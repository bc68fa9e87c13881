"""From a thread's LLVM code to PTX, the assembly language that the driver of NVIDIA's compiles.

LLVM's own back end writes it (llvmlite has it): nothing of NVIDIA's compilers is needed, but for
functions of the C library, which come from libdevice, a file of LLVM code that the CUDA packages of
JAX bring (`pip install "jax[cuda12]"`); their last digits may differ from those of the processor.
"""

import functools
import importlib.util
import os
import re
from pathlib import Path
from typing import Any

from jaxclear.native.writer import Unsupported

TRIPLE = "nvptx64-nvidia-cuda"
LIBRARY = re.compile(r"^declare double @(\w+)\((double(?:, double)?)\) nounwind.*$", re.M)
# Folders in which CUDA lies, by the variables that tell, and where its packages put it.
VARIABLES, USUAL = ("CUDA_HOME", "CUDA_PATH"), "/usr/local/cuda"
LIBDEVICE = "nvvm/libdevice/libdevice*.bc"
# Versions of LLVM's device, by the least capability of a GPU that runs its code; the driver
# compiles it for the GPU that is there.
PROCESSORS = {(8, 0): "sm_80", (7, 0): "sm_70"}


def processor_of(capability: tuple[int, int]) -> str:
    """What LLVM writes for, on a GPU of this capability. Raises `Unsupported` for an old one."""
    for least, name in PROCESSORS.items():
        if capability >= least:
            return name
    raise Unsupported(f"a GPU of compute capability {capability[0]}.{capability[1]}")


@functools.cache
def find_libdevice() -> Path | None:
    """The newest file of NVIDIA's functions; None where there is none."""
    spec = importlib.util.find_spec("nvidia")
    packages = [Path(each) for each in (spec.submodule_search_locations or [])] if spec else []
    roots = [Path(os.environ[name]) for name in VARIABLES if os.environ.get(name)]
    roots += [folder for each in packages for folder in sorted(each.glob("*"))]
    for root in [*roots, Path(USUAL)]:
        for candidate in sorted(root.glob(LIBDEVICE), reverse=True):
            return candidate
    return None


def ptx_of(text: str, processor: str) -> str:
    """PTX of a text for a device. Raises `Unsupported` where it calls what is not there."""
    import llvmlite.binding as llvm

    names = [name for name, _ in LIBRARY.findall(text)]
    library = find_libdevice() if names else None
    if names and library is None:
        raise Unsupported(
            f"{', '.join(sorted(names))} on a GPU without NVIDIA's libdevice, which is in the "
            'packages of "jax[cuda12]" and "jax[cuda13]"'
        )
    target = _target_machine(processor)
    module = llvm.parse_assembly(_use_libdevice(f'target triple = "{TRIPLE}"\n{text}', names))
    module.data_layout = str(target.target_data)
    if library is not None:
        functions = llvm.parse_bitcode(library.read_bytes())
        functions.triple, functions.data_layout = module.triple, module.data_layout
        module.link_in(functions)
        for function in module.functions:
            if function.name.startswith("__nv_") and not function.is_declaration:
                function.linkage = "internal"
    options = llvm.create_pipeline_tuning_options(speed_level=3)
    # A turn fills the registers; two of them would not fit.
    options.loop_unrolling = False
    passes = llvm.create_pass_builder(target, options)
    passes.getModulePassManager().run(module, passes)
    return target.emit_assembly(module)


def _use_libdevice(text: str, names: list[str]) -> str:
    """Calls of the C library as calls of libdevice, whose functions say themselves what they
    read."""
    for name in names:
        text = re.sub(rf"@{name}\(", f"@__nv_{name}(", text)
    return re.sub(r"^(declare double @__nv_\w+\([^)]*\)).*$", r"\1", text, flags=re.M)


def _target_machine(processor: str) -> Any:
    import llvmlite.binding as llvm

    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    try:
        target = llvm.Target.from_triple(TRIPLE)
    except RuntimeError as missing:
        raise Unsupported("a GPU by this llvmlite, which writes none for NVIDIA's") from missing
    return target.create_target_machine(cpu=processor, opt=3)
