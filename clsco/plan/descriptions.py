"""Descriptions of a plan's passes, for reports."""

from __future__ import annotations

from clsco.optics.lens_path import reference_camera
from clsco.optics.resolved_view import ellipticity_of
from clsco.plan.decisions import Choices
from clsco.plan.methods import BlurSpec
from clsco.plan.passes import Parameters
from clsco.scene.model import Scene


def shapes_of(scene: Scene) -> str:
    """Names of a scene's shapes, without duplicates."""
    return ", ".join(dict.fromkeys(item.shape for item in scene.objects))


def describe_rays(scene: Scene, choices: Choices, colors: int, alpha: bool) -> Parameters:
    """Description of rays and the surfaces that they hit; colors: number of color channels."""
    sampled = choices.texture_sampling.value
    moved: Parameters = (("texture sampling", scene.motion.texture_filter),) if sampled else ()
    if scene.has_mapped_textures:
        moved += (("surface textures", "means over the pixel's footprint, from mipmaps"),)
    first = ("rays", f"against the {shapes_of(scene)}, one per pixel")
    return (first, *describe_distortion(scene), *moved, *describe_frame(choices, colors, alpha))


def describe_pixels(scene: Scene, choices: Choices, colors: int, alpha: bool) -> Parameters:
    """Description of the pixels of a static depth map and its image; arguments as for `describe_rays`."""
    first = ("pixels", "as the depth map and its image have them")
    return (first, *describe_distortion(scene), *describe_frame(choices, colors, alpha))


def describe_distortion(scene: Scene) -> Parameters:
    """Description of the blur in a distorted image, where discs become ellipses; empty if the lens does not distort."""
    off = 100.0 * ellipticity_of(reference_camera(scene))
    words = f"blur of ellipses, whose rims are up to {off:.2g} % of R off those of discs of the same area"
    return (("distortion", words),) if scene.lens is not None and scene.lens.distorts else ()


def describe_frame(choices: Choices, colors: int, alpha: bool) -> Parameters:
    """Description of the grid and the channels of an image."""
    band = choices.guard_band
    guard = (("guard band", band.reason),) if band.value else ()
    color = (("color", f"{colors} channels"),) if colors > 1 else ()
    covers = (("alpha", "a channel of what surfaces cover"),) if alpha else ()
    return (*guard, *color, *covers)


def describe_blur(spec: BlurSpec, choices: Choices, groups: int) -> Parameters:
    """Description of the blur; groups: number of occlusion groups."""
    parameters = [
        ("PSF", f"{spec.psf.name}, R up to {spec.largest:.3g} px"),
        ("method", f"{spec.method}: {choices.blur.reason}"),
    ]
    if spec.psf.diffracted:
        from clsco.optics.waves import wave_words

        parameters += wave_words(spec.psf, spec.smallest, spec.largest, spec.subpixels)
    if spec.tilt:
        parameters.append(("tilt", "weights by the gradient of the blur radius"))
    if choices.renormalize.value:
        parameters.append(("renormalize", "light over the border is given back"))
    if choices.occlusion.value == "visibility":
        plural = "s" if groups > 1 else ""
        text = f"{groups} occlusion group{plural}, visibility tests where something is in the way"
        parameters.append(("occlusion", text))
    if choices.occlusion.value == "layered":
        parameters.append(("occlusion", "depth layers of what the pinhole sees, front to back"))
    return tuple(parameters)
