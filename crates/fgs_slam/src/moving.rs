//! What moves: parts of a frame that stand where earlier frames saw through. They are left out of that
//! frame, for tracking and for the map; what has stood still for long enough is taken in.
//!
//! Differs from the paper, which takes the world to be still.

use std::collections::VecDeque;
use std::sync::Arc;

use fgs_geom::{Camera, Image, RgbdFrame, Se3, has_depth};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// Images are compared in cells, so many in a row of them: fine enough for an arm, and coarse enough that a
/// pose that is a little off moves no edge by more than a cell.
const CELLS_ACROSS: usize = 80;

/// A frame is kept to compare with this often, and so many of them.
const INTERVAL_SECS: f64 = 0.5;
const KEPT: usize = 6;

/// What has moved may move again: it is taken in when it has stood still for so long.
const STILL_SECS: f64 = 20.0;

/// When a cell moved that never did.
const NEVER: f64 = f64::NEG_INFINITY;

/// Something stands in front of what an earlier frame saw if it is nearer by more than this, metres, and
/// this share of its depth: noise of far depth, and errors of poses.
const MARGIN_M: f64 = 0.05;
const MARGIN: f64 = 0.05;

/// A cell belongs to the same thing as its neighbour if their depths differ by less than this share.
const CONTINUOUS: f32 = 0.03;

/// What moves covers at least this share of the cells; less is noise.
const MIN_SHARE: f64 = 0.004;

/// Tells what moves.
#[derive(Clone, Default, Serialize, Deserialize)]
pub struct MovingThings {
    /// Earlier frames, the oldest first.
    seen: VecDeque<Seen>,
}

/// What moves in a frame.
pub struct Moving {
    /// When each cell last moved.
    moved_secs: Image<f64>,
    side_px: usize,
}

/// What an earlier frame saw.
#[derive(Clone, Serialize, Deserialize)]
struct Seen {
    timestamp_secs: f64,
    world_from_camera: Se3,
    cells: Cells,
    /// When each cell last moved.
    moved_secs: Image<f64>,
    /// Nothing was nearer than this around a cell; 0 where that is not known.
    free_to_m: Image<f32>,
}

/// A depth image in cells.
#[derive(Clone, Serialize, Deserialize)]
struct Cells {
    camera: Camera,
    /// The side of a cell, pixels.
    side_px: usize,
    /// The nearest depth in each cell, metres; 0 if less than half of it was measured.
    nearest_m: Image<f32>,
}

/// What earlier frames say of a cell.
#[derive(Clone, Copy, PartialEq)]
enum Cell {
    /// Nothing was there, or something that moved at this time.
    Moved { secs: f64 },
    /// Something was there.
    Known,
    /// They did not see the place.
    New,
}

impl MovingThings {
    /// What moves in a frame; `None` if all of it stands still. `moves` are pixels that are known to move.
    pub fn find(
        &self,
        frame: &RgbdFrame,
        world_from_camera: &Se3,
        moves: &[(usize, usize)],
    ) -> Option<Moving> {
        let cells = Cells::new(frame);
        let mut said = self.compare(&cells, world_from_camera, frame.timestamp_secs);
        for (u, v) in cells.holding(moves) {
            let secs = frame.timestamp_secs;
            said.set(u, v, Cell::Moved { secs });
        }
        let (width, height) = (said.width(), said.height());
        let mut moved_secs = Image::filled(width, height, NEVER);
        let mut is_visited = Image::filled(width, height, false);
        for (u, v) in (0..height).flat_map(|v| (0..width).map(move |u| (u, v))) {
            if !said.at(u, v).has_moved() || is_visited.at(u, v) {
                continue;
            }
            let thing = connected(u, v, &said, &cells, &mut is_visited);
            let secs = moved_at(&thing, &said);
            let with_margin = thing
                .iter()
                .flat_map(|(u, v)| around(*u, *v, width, height));
            for (u, v) in with_margin {
                moved_secs.set(u, v, moved_secs.at(u, v).max(secs));
            }
        }
        any_moves(&moved_secs).then_some(Moving {
            moved_secs,
            side_px: cells.side_px,
        })
    }

    /// A frame whose pose is trusted, with all that it shows, and what moves in it.
    pub fn observe(&mut self, frame: &RgbdFrame, world_from_camera: &Se3, moving: Option<&Moving>) {
        let now_secs = frame.timestamp_secs;
        // What begins to move is remembered at once: parts of it stand where it stood before.
        let is_news = |seen: &Seen| moving.is_some() && !any_moves(&seen.moved_secs);
        let is_recent =
            |seen: &Seen| (0.0..INTERVAL_SECS).contains(&(now_secs - seen.timestamp_secs));
        if (self.seen.back()).is_some_and(|seen| is_recent(seen) && !is_news(seen)) {
            return;
        }
        // Where stamps have gone back, nothing is known of what was before.
        let kept = now_secs - KEPT as f64 * INTERVAL_SECS..=now_secs;
        self.seen.retain(|seen| kept.contains(&seen.timestamp_secs));
        let cells = Cells::new(frame);
        let (width, height) = (cells.nearest_m.width(), cells.nearest_m.height());
        self.seen.push_back(Seen {
            timestamp_secs: now_secs,
            world_from_camera: *world_from_camera,
            free_to_m: cells.nearest_around(),
            moved_secs: moving.map_or_else(
                || Image::filled(width, height, NEVER),
                |moving| moving.moved_secs.clone(),
            ),
            cells,
        });
    }

    /// Whether all earlier frames are of a camera.
    pub fn are_of(&self, camera: &Camera) -> bool {
        let side_px = Cells::side_px(camera);
        let (width, height) = Cells::size(camera);
        self.seen.iter().all(|seen| {
            let sizes = [
                (seen.cells.nearest_m.width(), seen.cells.nearest_m.height()),
                (seen.free_to_m.width(), seen.free_to_m.height()),
                (seen.moved_secs.width(), seen.moved_secs.height()),
            ];
            seen.cells.camera == *camera
                && seen.cells.side_px == side_px
                && sizes.iter().all(|size| *size == (width, height))
        })
    }

    /// The world moved rigidly, and all earlier frames with it.
    pub fn move_world(&mut self, new_from_old: &Se3) {
        for seen in &mut self.seen {
            seen.world_from_camera = *new_from_old * seen.world_from_camera;
        }
    }

    fn compare(&self, cells: &Cells, world_from_camera: &Se3, now_secs: f64) -> Image<Cell> {
        let (width, height) = (cells.nearest_m.width(), cells.nearest_m.height());
        let seen: Vec<_> = (self.seen.iter())
            .map(|seen| {
                let seen_from_camera = seen.world_from_camera.inverse() * *world_from_camera;
                let rotation = seen_from_camera.rotation.to_rotation_matrix();
                (seen, rotation, seen_from_camera.translation)
            })
            .collect();
        Image::from_fn(width, height, |u, v| {
            let Some(point) = cells.point(u, v) else {
                return Cell::New;
            };
            seen.iter()
                .fold(Cell::New, |said, (seen, rotation, translation)| {
                    said.and(seen.at(&(rotation * point + translation), now_secs))
                })
        })
    }
}

impl Moving {
    /// The share of the image that moves.
    pub fn share(&self) -> f64 {
        let moving = (self.moved_secs.data().iter()).filter(|secs| **secs > NEVER);
        moving.count() as f64 / self.moved_secs.data().len() as f64
    }

    /// The frame without it.
    pub fn left_out_of(&self, frame: &RgbdFrame) -> RgbdFrame {
        let cell = |at: usize, across: usize| (at / self.side_px).min(across - 1);
        let (across, down) = (self.moved_secs.width(), self.moved_secs.height());
        let moves = |u, v| self.moved_secs.at(cell(u, across), cell(v, down)) > NEVER;
        let (width, height) = (frame.camera.width, frame.camera.height);
        let mut still = frame.clone();
        for (u, v) in (0..height).flat_map(|v| (0..width).map(move |u| (u, v))) {
            if moves(u, v) {
                still.depth_m.set(u, v, 0.0);
            }
        }
        let seen = Image::from_fn(width, height, |u, v| !moves(u, v) && frame.has_color(u, v));
        still.color_valid = Some(Arc::new(seen));
        still
    }
}

impl Cell {
    fn has_moved(self) -> bool {
        matches!(self, Self::Moved { .. })
    }

    /// What two frames say together.
    fn and(self, other: Self) -> Self {
        match (self, other) {
            (Self::Moved { secs: a }, Self::Moved { secs: b }) => Self::Moved { secs: a.max(b) },
            (Self::Moved { .. }, _) | (_, Self::New) => self,
            _ => other,
        }
    }
}

impl Seen {
    /// What this frame says of a point in its camera's axes.
    fn at(&self, point: &Vector3<f64>, now_secs: f64) -> Cell {
        let Some((u, v)) = self.cells.cell(point) else {
            return Cell::New;
        };
        let margin = MARGIN_M + MARGIN * point.z;
        let free_to_m = f64::from(self.free_to_m.at(u, v));
        let nearest_m = f64::from(self.cells.nearest_m.at(u, v));
        let moved_secs = self.moved_secs.at(u, v);
        if free_to_m > point.z + margin {
            Cell::Moved { secs: now_secs }
        } else if nearest_m == 0.0 || nearest_m < point.z - margin {
            Cell::New
        } else if moved_secs == NEVER {
            Cell::Known
        } else if nearest_m < point.z + margin && now_secs - moved_secs < STILL_SECS {
            Cell::Moved { secs: moved_secs }
        } else {
            Cell::New
        }
    }
}

impl Cells {
    fn side_px(camera: &Camera) -> usize {
        (camera.width / CELLS_ACROSS).max(1)
    }

    /// How many there are across and down.
    fn size(camera: &Camera) -> (usize, usize) {
        let side_px = Self::side_px(camera);
        (camera.width / side_px, (camera.height / side_px).max(1))
    }

    fn new(frame: &RgbdFrame) -> Self {
        let camera = frame.camera;
        let side_px = Self::side_px(&camera);
        let (width, height) = Self::size(&camera);
        let nearest_m = Image::from_fn(width, height, |u, v| {
            let rows = (v * side_px)..((v + 1) * side_px).min(camera.height);
            let depths = rows.flat_map(|row| &frame.depth_m.row(row)[u * side_px..][..side_px]);
            let measured = depths.copied().filter(|depth| has_depth(*depth));
            let (nearest, count) = measured.fold((f32::INFINITY, 0), |(nearest, count), depth| {
                (nearest.min(depth), count + 1)
            });
            if 2 * count < side_px * side_px {
                0.0
            } else {
                nearest
            }
        });
        Self {
            camera,
            side_px,
            nearest_m,
        }
    }

    /// The cells in which pixels are.
    fn holding(&self, pixels: &[(usize, usize)]) -> impl Iterator<Item = (usize, usize)> {
        let (width, height) = (self.nearest_m.width(), self.nearest_m.height());
        let cell = move |at: usize| at / self.side_px;
        let cells = pixels.iter().map(move |(u, v)| (cell(*u), cell(*v)));
        cells.filter(move |(u, v)| *u < width && *v < height)
    }

    /// The point at the middle of a cell, in the camera's axes.
    fn point(&self, u: usize, v: usize) -> Option<Vector3<f64>> {
        let depth = self.nearest_m.at(u, v);
        let middle = |cell: usize| (cell * self.side_px) as f64 + 0.5 * (self.side_px as f64 - 1.0);
        (depth > 0.0).then(|| (self.camera).unproject(middle(u), middle(v), depth.into()))
    }

    /// The cell in which a point in the camera's axes is seen.
    fn cell(&self, point: &Vector3<f64>) -> Option<(usize, usize)> {
        let pixel = self.camera.project(point)?;
        let side = self.side_px as f64;
        let (u, v) = ((pixel.x + 0.5) / side, (pixel.y + 0.5) / side);
        let inside = u >= 0.0
            && v >= 0.0
            && u < self.nearest_m.width() as f64
            && v < self.nearest_m.height() as f64;
        inside.then_some((u as usize, v as usize))
    }

    /// The nearest depth in a cell and those around it; 0 where one is not known.
    fn nearest_around(&self) -> Image<f32> {
        let (width, height) = (self.nearest_m.width(), self.nearest_m.height());
        Image::from_fn(width, height, |u, v| {
            let depths = around(u, v, width, height).map(|(u, v)| self.nearest_m.at(u, v));
            depths.fold(f32::INFINITY, f32::min)
        })
    }
}

fn any_moves(moved_secs: &Image<f64>) -> bool {
    moved_secs.data().iter().any(|secs| *secs > NEVER)
}

/// A cell and those around it.
fn around(u: usize, v: usize, width: usize, height: usize) -> impl Iterator<Item = (usize, usize)> {
    let range = |at: usize, size: usize| at.saturating_sub(1)..(at + 2).min(size);
    range(v, height).flat_map(move |v| range(u, width).map(move |u| (u, v)))
}

/// The thing to which a moved cell belongs: moved and new cells without a step in depth between them.
fn connected(
    u: usize,
    v: usize,
    said: &Image<Cell>,
    cells: &Cells,
    is_visited: &mut Image<bool>,
) -> Vec<(usize, usize)> {
    let depth = |u, v| cells.nearest_m.at(u, v);
    let mut thing = vec![(u, v)];
    is_visited.set(u, v, true);
    let mut next = 0;
    while let Some(&(u, v)) = thing.get(next) {
        next += 1;
        let here = depth(u, v);
        for (near_u, near_v) in around(u, v, said.width(), said.height()) {
            let there = depth(near_u, near_v);
            let is_same = there > 0.0 && (there - here).abs() < CONTINUOUS * here;
            if is_same && said.at(near_u, near_v) != Cell::Known && !is_visited.at(near_u, near_v) {
                is_visited.set(near_u, near_v, true);
                thing.push((near_u, near_v));
            }
        }
    }
    thing
}

/// When a thing last moved, if it is large enough to be one. A strip is the edge of something, seen from a
/// pose that is a little off.
fn moved_at(thing: &[(usize, usize)], said: &Image<Cell>) -> f64 {
    let (width, height) = (said.width(), said.height());
    let has_moved = |(u, v): (usize, usize)| said.at(u, v).has_moved();
    let is_thick = |(u, v): &(usize, usize)| around(*u, *v, width, height).all(has_moved);
    let times = thing.iter().filter_map(|(u, v)| match said.at(*u, *v) {
        Cell::Moved { secs } => Some(secs),
        _ => None,
    });
    let is_large = times.clone().count() as f64 > MIN_SHARE * (width * height) as f64;
    if is_large && thing.iter().any(is_thick) {
        times.fold(NEVER, f64::max)
    } else {
        NEVER
    }
}

#[cfg(test)]
mod tests {
    use fgs_geom::{FrameIndex, Intrinsics};
    use nalgebra::Vector6;

    use super::*;

    const WALL_M: f64 = 3.0;
    const THING_M: f64 = 1.5;
    const FRAME_SECS: f64 = 0.1;

    /// A wall, and before it a thing half a metre wide whose middle is at `thing_m` along x in the world.
    fn frame(secs: f64, thing_m: f64, world_from_camera: &Se3) -> RgbdFrame {
        let intrinsics = Intrinsics {
            fx: 160.0,
            fy: 160.0,
            cx: 79.5,
            cy: 59.5,
        };
        let camera = Camera::new(160, 120, intrinsics).unwrap();
        let depth_m = Image::from_fn(160, 120, |u, v| {
            let ray = camera.ray(u as f64, v as f64);
            let in_world = world_from_camera.rotation * ray;
            let depth_of = |plane: f64| (plane - world_from_camera.translation.z) / in_world.z;
            let x = world_from_camera.translation.x + depth_of(THING_M) * in_world.x;
            let is_thing = (x - thing_m).abs() < 0.25;
            depth_of(if is_thing { THING_M } else { WALL_M }) as f32
        });
        let color = Image::filled(160, 120, [100; 3]);
        RgbdFrame::new(FrameIndex(0), secs, color, depth_m, camera).unwrap()
    }

    /// A hand that turns and moves.
    fn camera(secs: f64) -> Se3 {
        Se3::exp(&(secs.sin() * Vector6::new(0.05, 0.1, 0.05, 0.1, 0.1, 0.05)))
    }

    /// The shares that move when the thing is at each of these places, a frame each; poses are off by as
    /// much as the motion in `off_secs`.
    fn shares(thing_m: impl IntoIterator<Item = f64>, off_secs: f64) -> Vec<f64> {
        let mut things = MovingThings::default();
        let share = |(i, thing_m): (usize, f64)| {
            let secs = FRAME_SECS * i as f64;
            let frame = frame(secs, thing_m, &camera(secs));
            let pose = camera(secs + if i % 2 == 0 { off_secs } else { 0.0 });
            let moving = things.find(&frame, &pose, &[]);
            things.observe(&frame, &pose, moving.as_ref());
            moving.map_or(0.0, |moving| moving.share())
        };
        thing_m.into_iter().enumerate().map(share).collect()
    }

    #[test]
    fn a_still_world_does_not_move_and_small_errors_of_poses_do_not_matter() {
        assert_eq!(shares([0.1; 60], 0.0), [0.0; 60]);
        // Up to half a degree and 1 cm.
        assert_eq!(shares([0.1; 60], 0.07), [0.0; 60]);
    }

    #[test]
    fn a_thing_moves_and_is_taken_in_after_it_has_stood_still() {
        let walk = (0..20).map(|i| 0.05 * f64::from(i) - 0.5);
        let shares = shares(walk.chain([0.45; 300]), 0.0);
        // It takes up a third of the image.
        assert!(
            shares[8..20].iter().all(|share| (0.2..0.5).contains(share)),
            "{shares:?}"
        );
        let taken_in = 20 + ((KEPT as f64 * INTERVAL_SECS + STILL_SECS) / FRAME_SECS) as usize + 6;
        assert!(
            shares[20..200].iter().all(|share| *share > 0.2),
            "{shares:?}"
        );
        assert!(
            shares[taken_in..].iter().all(|share| *share == 0.0),
            "{shares:?}"
        );
    }

    #[test]
    fn stamps_that_go_back_begin_anew() {
        let mut things = MovingThings::default();
        for secs in [10.0, 10.2, 10.6, 11.2] {
            things.observe(&frame(secs, 0.0, &camera(0.0)), &camera(0.0), None);
        }
        assert_eq!(things.seen.len(), 3);
        things.observe(&frame(1.0, 0.4, &camera(0.0)), &camera(0.0), None);
        assert_eq!(things.seen.len(), 1);
        let again = frame(1.1, 0.4, &camera(0.0));
        assert!(things.find(&again, &camera(0.0), &[]).is_none());
    }

    #[test]
    fn what_moves_is_left_out_of_depth_and_colour_and_nothing_else_is() {
        let mut things = MovingThings::default();
        things.observe(&frame(0.0, -0.4, &camera(0.0)), &camera(0.0), None);
        let moved = frame(0.5, 0.4, &camera(0.5));
        let still = things
            .find(&moved, &camera(0.5), &[])
            .unwrap()
            .left_out_of(&moved);
        let pixels = || (0..120).flat_map(|v| (0..160).map(move |u| (u, v)));
        let is_thing = |u, v| moved.depth_m.at(u, v) < 2.0;
        assert!(pixels().filter(|(u, v)| is_thing(*u, *v)).count() > 3000);
        for (u, v) in pixels() {
            let is_left_out = still.depth_m.at(u, v) == 0.0;
            assert_eq!(is_left_out, !still.has_color(u, v));
            assert!(is_left_out || !is_thing(u, v), "{u} {v}");
            let near =
                |u: usize, v| (u.saturating_sub(4)..(u + 5).min(160)).any(|u| is_thing(u, v));
            assert!(!is_left_out || near(u, v), "{u} {v}");
        }
        assert!(still.check().is_ok());
    }

    #[test]
    fn what_is_known_to_move_is_remembered_at_once_and_moves_where_it_overlaps_what_it_was() {
        let mut things = MovingThings::default();
        things.observe(&frame(0.0, 0.0, &camera(0.0)), &camera(0.0), None);
        let seen = frame(FRAME_SECS, 0.02, &camera(FRAME_SECS));
        let pose = camera(FRAME_SECS);
        assert!(things.find(&seen, &pose, &[]).is_none());
        let pixels = (0..120).flat_map(|v| (0..160).map(move |u| (u, v)));
        let thing: Vec<_> = pixels
            .filter(|(u, v)| seen.depth_m.at(*u, *v) < 2.0)
            .collect();
        let moving = things.find(&seen, &pose, &thing).unwrap();
        assert!(moving.share() > 0.2);
        things.observe(&seen, &pose, Some(&moving));
        let next = frame(2.0 * FRAME_SECS, 0.04, &camera(2.0 * FRAME_SECS));
        let moving = things.find(&next, &camera(2.0 * FRAME_SECS), &[]).unwrap();
        assert!(moving.share() > 0.2, "{}", moving.share());
    }
}
