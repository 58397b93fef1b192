"""A scene file that renders in a moment, and Ctrl-C as a terminal sends it."""

import signal
from pathlib import Path

import drjit as dr
import mitsuba as mi

SCENE = """<scene version="3.0.0">
  <default name="sigma_a" value="0.002, 0.004, 0.007"/>
  <default name="bsdf" value="pellucid_translucent"/>
  {integrator}
  <sensor type="perspective">
    <transform name="to_world"><lookat origin="0, -20, 6" target="0, 0, 0" up="0, 0, 1"/></transform>
    <float name="fov" value="25"/>
    <film type="hdrfilm">
      <integer name="width" value="24"/> <integer name="height" value="16"/> <rfilter type="box"/>
    </film>
    <sampler type="independent"><integer name="sample_count" value="2"/></sampler>
  </sensor>
  <sensor type="perspective">
    <transform name="to_world"><lookat origin="9, -20, 6" target="900, 0, 0" up="0, 0, 1"/></transform>
    <film type="hdrfilm"><integer name="width" value="8"/> <integer name="height" value="8"/></film>
  </sensor>
  {emitter}
  <shape type="sphere" id="ball">
    <float name="radius" value="3"/>
    <bsdf type="$bsdf">{medium}</bsdf>
  </shape>
</scene>
"""

INTEGRATOR = """<integrator type="pellucid_two_pass">
    <integer name="max_depth" value="3"/> <float name="max_error" value="0.7"/>
    <string name="sampling" value="uniform"/> <integer name="sample_count" value="300"/>
  </integrator>"""

MEDIUM = '<rgb name="sigma_a" value="$sigma_a"/> <rgb name="sigma_s_prime" value="2.2, 2.6, 3"/>'


def write_scene(path: Path, integrator=INTEGRATOR, medium=MEDIUM, emitter='<emitter type="constant"/>') -> Path:
    path.write_text(SCENE.format(integrator=integrator, medium=medium, emitter=emitter))
    return path


def control_c(*_):
    """Press Ctrl-C."""
    signal.raise_signal(signal.SIGINT)


def control_c_while_recording(*_):
    """Press Ctrl-C while Dr.Jit records a loop, which makes a RuntimeError of it."""
    dr.while_loop((mi.UInt32(0),), lambda index: index < 3, control_c)
