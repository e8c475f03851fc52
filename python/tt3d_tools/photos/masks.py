"""Step 4: masks. GrabCut separates each picture; the visual hull makes the pictures agree.

The object is what all cameras look at. Sparse points of the object project into its silhouette in
every view, whether they are hidden or not, and so are sure foreground; points elsewhere are sure
background where they were seen. GrabCut (Rother et al. 2004) spreads these seeds. Space that nearly
all views call object is the hull; it clips the next round of GrabCut and repairs views that failed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np

from tt3d_tools import toolkit
from tt3d_tools.photos.sparse import Model
from tt3d_tools.photos.upright import Place

SIDE = 640  # pixels, longest side on which GrabCut works
GRID = 112  # voxels along the longest side of the box
SEEN = 0.8  # fraction of the views that must see a place of the object
ROUNDS = ((0.75, 400), (0.85, 400), (0.88, SIDE))  # agreement of the views, pixels
AGREED = 0.92  # fraction of the views that must agree with the final hull, which cuts all masks
CORE = 0.97  # fraction of the views that make a voxel object against a view's own mask
MARGIN = 0.05  # of the picture's longer side: how far the object may reach beyond its points
BAND = 0.03  # of the picture's longer side: how far the object may reach beyond the hull

Segmenter = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


@dataclass
class Picture:
    """One view at the size on which the masks are made."""

    index: int  # of the view in the model
    pixels: np.ndarray  # [H,W,3] BGR
    scale: float  # pixels here over pixels of the photograph
    mask: np.ndarray  # [H,W] bool
    given: bool = False  # the user's own mask, never changed
    hull: np.ndarray = field(default_factory=lambda: np.zeros((0, 0), bool))


@dataclass
class Seeds:
    """What the sparse points tell about the pixels of a view, each [H,W] bool."""

    inside: np.ndarray  # object: points of the object project here
    near: np.ndarray  # close to such points
    outside: np.ndarray  # background: beyond the points' convex hull, or a point of something else


@dataclass
class Space:
    """Voxels of the box in which the object may be."""

    low: np.ndarray
    step: float
    shape: tuple[int, int, int]
    centres: np.ndarray  # [V,3]


def make_space(model: Model, place: Place, reach: np.ndarray | None = None) -> Space:
    """Return the voxels around the object: of what most views see, above the floor."""
    if reach is None:
        half = 1.6 * place.radius * max_aspect(model)
        low, high = place.centre - half, place.centre + half
    else:
        low, high = reach
    bottom = place.floor if place.floor is not None else place.bottom
    if bottom is not None:
        low = np.array([low[0], low[1], max(low[2], bottom)])
    step = float((high - low).max()) / GRID
    shape = tuple(int(n) for n in np.maximum(1, np.ceil((high - low) / step)))
    axes = [low[k] + (np.arange(shape[k]) + 0.5) * step for k in range(3)]
    centres = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    return Space(low, step, shape, centres)  # type: ignore[arg-type]


def max_aspect(model: Model) -> float:
    """Return longer over shorter side of the pictures."""
    return max(
        max(lens.width / lens.height, lens.height / lens.width) for lens in model.lenses.values()
    )


def visible(model: Model, points: np.ndarray) -> np.ndarray:
    """Return the fraction of the views [N] whose picture contains each point."""
    count = np.zeros(len(points))
    for view in model.views:
        lens = model.lens(view)
        pixels, depth = model.project(view, points)
        with np.errstate(invalid="ignore"):
            inside = (pixels >= 0).all(1) & (pixels < [lens.width, lens.height]).all(1)
        count += inside & (depth > 0)
    return count / len(model.views)


def object_points(model: Model, place: Place) -> np.ndarray:
    """Return which sparse points belong to the object [P]: seen by most views, above the floor, in
    one cluster around the point that the cameras look at."""
    from scipy import ndimage

    points = model.points
    near = (visible(model, points) >= SEEN) & (model.errors < 2) & (model.track_lengths >= 3)
    distance = np.linalg.norm(points - place.centre, axis=1)
    near &= distance < 1.2 * place.radius * max_aspect(model)
    if place.floor is not None:
        near &= points[:, 2] > place.floor + 0.03 * place.radius
    if near.sum() < 30:
        return near
    # Clusters: occupied cells of a coarse grid that touch.
    cell = place.radius / 12
    keys = np.floor((points[near] - place.centre) / cell).astype(int)
    low = keys.min(0)
    grid = np.zeros(keys.max(0) - low + 3, np.int32)
    np.add.at(grid, tuple((keys - low + 1).T), 1)
    labels, _ = ndimage.label(ndimage.binary_dilation(grid > 0), np.ones((3, 3, 3)))
    label = labels[tuple((keys - low + 1).T)]
    pull = np.exp(-((distance[near] / (0.5 * place.radius)) ** 2))
    weight = np.bincount(label, pull)
    chosen = np.isin(label, np.flatnonzero(weight > 0.25 * weight.max()))
    dense = grid[tuple((keys - low + 1).T)] > 0
    around = ndimage.uniform_filter((grid).astype(np.float32), 3) * 27
    dense &= around[tuple((keys - low + 1).T)] >= 3
    out = np.zeros(len(points), bool)
    out[np.flatnonzero(near)[chosen & dense]] = True
    return out


def load_pictures(model: Model, images: Path, side: int) -> list[Picture]:
    """Read all views, reduced to `side`."""
    pictures = []
    for index, view in enumerate(model.views):
        pixels = cv2.imread(str(images / view.name))
        if pixels is None:
            raise toolkit.InputProblem(f"{images / view.name}: cannot be read")
        scale = min(1.0, side / max(pixels.shape[:2]))
        size = (round(pixels.shape[1] * scale), round(pixels.shape[0] * scale))
        small = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)
        pictures.append(Picture(index, small, scale, np.zeros(small.shape[:2], bool)))
    return pictures


def draw_points(shape: tuple[int, ...], pixels: np.ndarray, radius: int) -> np.ndarray:
    """Return a mask [H,W] with a disc at each pixel position."""
    mask = np.zeros(shape[:2], np.uint8)
    with np.errstate(invalid="ignore"):
        inside = (pixels >= 0).all(1) & (pixels < [shape[1], shape[0]]).all(1)
    at = pixels[inside].astype(int)
    mask[at[:, 1], at[:, 0]] = 1
    return cv2.dilate(mask, disc(radius)) > 0 if radius > 0 else mask > 0


def disc(radius: int) -> np.ndarray:
    """Return a round structuring element."""
    return cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))


def grow(mask: np.ndarray, radius: int) -> np.ndarray:
    """Dilate (radius > 0) or erode (radius < 0) a mask."""
    if radius == 0:
        return mask
    change = cv2.dilate if radius > 0 else cv2.erode
    return change(mask.astype(np.uint8), disc(abs(radius))) > 0


def grab_cut(pixels: np.ndarray, trimap: np.ndarray, rounds: int) -> np.ndarray:
    """Return the foreground [H,W] of a picture with GrabCut's four marks in `trimap`."""
    marks = trimap.copy()
    foreground = (marks & 1) == 1
    if foreground.sum() < 20 or (~foreground).sum() < 20:
        return foreground
    models = np.zeros((2, 1, 65))
    cv2.setRNGSeed(0)
    cv2.grabCut(pixels, marks, None, models[0], models[1], rounds, cv2.GC_INIT_WITH_MASK)
    return (marks & 1) == 1


def seeds_of(model: Model, picture: Picture, of_object: np.ndarray, place: Place) -> Seeds:
    """Return what the sparse points tell about a view."""
    view = model.views[picture.index]
    shape = picture.pixels.shape
    longer = max(shape)
    pixels, _ = model.project(view, model.points[of_object])
    inside = draw_points(shape, pixels * picture.scale, 1)
    near = draw_points(shape, pixels * picture.scale, round(0.02 * longer))
    outside = np.zeros(shape[:2], bool)
    at = np.argwhere(inside)[:, ::-1].astype(np.int32)
    if len(at) >= 30:
        hull = np.zeros(shape[:2], np.uint8)
        cv2.fillConvexPoly(hull, cv2.convexHull(at), 1)
        outside = ~grow(hull > 0, round(MARGIN * longer))
    seen = view.points >= 0
    elsewhere = view.keypoints[seen][~of_object[view.points[seen]]]
    outside |= draw_points(shape, elsewhere * picture.scale, 2)
    if place.floor is not None:
        outside |= below_floor(model, picture, place)
    return Seeds(inside, near, outside & ~inside)


def first_marks(seeds: Seeds) -> np.ndarray:
    """Return the marks of the first GrabCut of a view."""
    marks = np.full(seeds.inside.shape, cv2.GC_PR_BGD, np.uint8)
    marks[seeds.near] = cv2.GC_PR_FGD
    marks[seeds.outside] = cv2.GC_BGD
    marks[seeds.inside] = cv2.GC_FGD
    return marks


def below_floor(model: Model, picture: Picture, place: Place) -> np.ndarray:
    """Return pixels [H,W] whose ray meets the support plane in front of the object's place.

    Only the part of the plane between the camera and the near side of the object is sure: the
    object hides the rest.
    """
    view = model.views[picture.index]
    assert place.floor is not None
    origin = view.position
    away = place.centre[:2] - origin[:2]
    distance = np.linalg.norm(away)
    if distance < 1e-9 or origin[2] < place.floor:
        return np.zeros(picture.pixels.shape[:2], bool)
    shape = picture.pixels.shape[:2]
    fx, fy, cx, cy = model.lens(view).matrix()
    y, x = np.mgrid[0 : shape[0], 0 : shape[1]]
    rays = np.stack(
        [
            ((x + 0.5) / picture.scale - cx) / fx,
            ((y + 0.5) / picture.scale - cy) / fy,
            np.ones(shape),
        ],
        -1,
    )
    world = rays @ view.rotation
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = (place.floor - origin[2]) / world[..., 2]
        ahead = (world[..., :2] * reach[..., None]) @ (away / distance)
    return (reach > 0) & (ahead < distance - 1.3 * place.radius * max_aspect(model))


def carve(model: Model, space: Space, pictures: list[Picture]) -> np.ndarray:
    """Return the fraction of the views that call each voxel object [V].

    A fifth of the views may miss a voxel; more that miss it count against it.
    """
    yes = np.zeros(len(space.centres), np.float32)
    seen = np.zeros(len(space.centres), np.float32)
    for picture in pictures:
        if not picture.mask.any():
            continue
        pixels, depth = model.project(model.views[picture.index], space.centres)
        height, width = picture.mask.shape
        with np.errstate(invalid="ignore"):
            at = np.floor(pixels * picture.scale)
            inside = (at >= 0).all(1) & (at < [width, height]).all(1) & (depth > 0)
        at = at[inside].astype(int)
        seen[inside] += 1
        yes[inside] += picture.mask[at[:, 1], at[:, 0]]
    return yes / np.maximum(seen, SEEN * sum(picture.mask.any() for picture in pictures))


def main_body(space: Space, solid: np.ndarray, place: Place) -> np.ndarray:
    """Return the connected body of voxels nearest to the place of the object [V]."""
    from scipy import ndimage

    labels, count = ndimage.label(solid.reshape(space.shape), np.ones((3, 3, 3)))
    if count == 0:
        return solid
    flat = labels.reshape(-1)
    distance = np.linalg.norm(space.centres - place.centre, axis=1)
    weight = np.bincount(flat, np.exp(-((distance / place.radius) ** 2)))
    weight[0] = 0
    return flat == int(np.argmax(weight))


def silhouette(model: Model, space: Space, solid: np.ndarray, picture: Picture) -> np.ndarray:
    """Return the picture of the voxels [H,W]."""
    from scipy import ndimage

    body = solid.reshape(space.shape)
    skin = solid & ~ndimage.binary_erosion(body).reshape(-1)
    view = model.views[picture.index]
    pixels, depth = model.project(view, space.centres[skin])
    if len(depth) == 0:
        return np.zeros(picture.mask.shape, bool)
    focal = model.lens(view).matrix()[0] * picture.scale
    radius = max(1, int(np.ceil(0.6 * space.step * focal / max(np.median(depth), 1e-9))))
    mask = draw_points(picture.pixels.shape, pixels * picture.scale, radius)
    # Fill the inside, which has no skin voxels in front of it only if the skin has gaps.
    return cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_CLOSE, disc(radius)) > 0


def tighten(space: Space, solid: np.ndarray) -> np.ndarray:
    """Return low and high corners of the solid voxels with a margin [2,3]."""
    chosen = space.centres[solid]
    low, high = chosen.min(0), chosen.max(0)
    margin = 0.08 * float((high - low).max()) + space.step
    return np.stack([low - margin, high + margin])


def clean(mask: np.ndarray, support: np.ndarray) -> np.ndarray:
    """Drop pieces that do not touch the hull's silhouette and fill pinholes."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8))
    out = np.zeros_like(mask)
    for i in range(1, count):
        piece = labels == i
        if (piece & support).sum() > 0.5 * stats[i, cv2.CC_STAT_AREA]:
            out |= piece
    count, labels, stats, _ = cv2.connectedComponentsWithStats(
        (~out).astype(np.uint8), connectivity=4
    )
    for i in range(1, count):
        if stats[i, cv2.CC_STAT_AREA] < 2e-4 * mask.size:
            out |= labels == i
    return out


def resize_mask(mask: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Return the mask at another size (width, height), smooth at the border."""
    soft = cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_LINEAR)
    return soft > 0.5


def rounds_of(
    model: Model,
    place: Place,
    images: Path,
    given: dict[int, np.ndarray],
    of_object: np.ndarray,
    start: list[Picture],
) -> tuple[list[Picture], Space, np.ndarray]:
    """Alternate hull and GrabCut; return the pictures, and the hull's space and voxels."""
    reach: np.ndarray | None = None
    pictures = start
    space = make_space(model, place)
    solid = np.zeros(len(space.centres), bool)
    total = (len(ROUNDS) + 1) * len(pictures)
    for number, (agreement, side) in enumerate(ROUNDS):
        space = make_space(model, place, reach)
        share = carve(model, space, pictures)
        solid = main_body(space, share >= agreement, place)
        if not solid.any():
            raise toolkit.InputProblem(
                "the masks of the photographs have no object in common; paint masks yourself into "
                "masks/ (white is the object), or take photographs with the object in the middle"
            )
        reach = tighten(space, solid)
        fresh = load_pictures(model, images, side)
        for picture, before in zip(fresh, pictures, strict=True):
            if before.given:
                size = picture.pixels.shape[1::-1]
                picture.mask, picture.given = resize_mask(given[picture.index], size), True
                continue
            picture.hull = silhouette(model, space, solid, picture)
            core = silhouette(model, space, solid & (share >= CORE), picture)
            improve(picture, before, core, seeds_of(model, picture, of_object, place))
            toolkit.progress(len(pictures) * (number + 1) + picture.index + 1, total)
        pictures = fresh
    space = make_space(model, place, reach)
    solid = main_body(space, carve(model, space, pictures) >= AGREED, place)
    for picture in pictures:
        if not picture.given and solid.any():
            hull = silhouette(model, space, solid, picture)
            picture.mask = clean(picture.mask & grow(hull, 2), hull)
    return pictures, space, solid


def improve(picture: Picture, before: Picture, core: np.ndarray, seeds: Seeds) -> None:
    """Segment one view again, within the hull's silhouette; `core` is that of its sure voxels."""
    hull = picture.hull
    band = max(2, round(BAND * max(picture.pixels.shape)))
    old = resize_mask(before.mask, picture.pixels.shape[1::-1])
    inner = grow(core, -band) & ~seeds.outside
    marks = np.full(hull.shape, cv2.GC_BGD, np.uint8)
    marks[grow(hull, band)] = cv2.GC_PR_BGD
    marks[hull & old] = cv2.GC_PR_FGD
    marks[seeds.outside] = cv2.GC_BGD
    marks[inner | (seeds.inside & hull)] = cv2.GC_FGD
    mask = grab_cut(picture.pixels, marks, 3)
    picture.mask = clean(mask & grow(hull, max(1, band // 3)) | inner, hull)


def make_masks(
    model: Model,
    place: Place,
    images: Path,
    given: dict[int, np.ndarray],
    network: Callable[[Path], np.ndarray] | None = None,
) -> tuple[list[Picture], Space, np.ndarray]:
    """Return the views with masks at SIDE, and the hull (space and solid voxels).

    `given` has the user's own masks by view, [H,W] bool. `network` returns the object's probability
    of a photograph; without it, GrabCut starts from the sparse points.
    """
    of_object = object_points(model, place)
    if place.floor is None and of_object.sum() >= 100:
        # Without a support plane the object ends where its points end.
        heights = model.points[of_object][:, 2]
        place.bottom = float(np.quantile(heights, 0.005) - 0.03 * place.radius)
    if of_object.sum() < 30 and not given and network is None:
        raise toolkit.InputProblem(
            "too few points of the object could be matched to find it in the photographs: it may "
            "have no texture or shine; paint masks yourself into masks/, white is the object"
        )
    pictures = load_pictures(model, images, ROUNDS[0][1])
    for picture in pictures:
        size = picture.pixels.shape[1::-1]
        if picture.index in given:
            picture.mask, picture.given = resize_mask(given[picture.index], size), True
        elif network is not None:
            probability = network(images / model.views[picture.index].name)
            picture.mask = cv2.resize(probability, size) > 0.5
        else:
            seeds = seeds_of(model, picture, of_object, place)
            picture.mask = grab_cut(picture.pixels, first_marks(seeds), 4)
        toolkit.progress(picture.index + 1, (len(ROUNDS) + 1) * len(pictures))
    return rounds_of(model, place, images, given, of_object, pictures)
