//! The stages of a step in dispatch order: projection, tile lists and blending; loss and gradients;
//! Adam.

use fgs_geom::View as CameraView;

use super::buffers::{DEPTH_PASSES, TILE_PASSES};
use super::layout::{self, Dispatch, GROUP, LOSS_SIDE, NONE, TILE};
use super::recorder::{Groups, Recorder};
use crate::GpuError;
use crate::cpu::{Frustum, ScreenCamera};
use crate::losses::{DEPTH_UNIT_M, LossSettings, Target};

/// Number of workgroups for `count` items, one thread each.
pub fn workgroups(count: usize) -> u32 {
    (count as u32).div_ceil(GROUP)
}

/// A dispatch of that many workgroups.
pub fn groups(count: usize) -> Groups {
    Groups::Fixed(workgroups(count), 1)
}

/// A view's uniform, for `count` gaussians and tile lists of that capacity; no visibility set.
pub fn view_uniform(view: &CameraView, count: usize, capacity: usize) -> layout::View {
    let camera = ScreenCamera::<f32>::new(view);
    let frustum = Frustum::new(&camera);
    let [row_x, row_y, row_z] = camera.camera_from_world;
    let [width, height] = [camera.width, camera.height].map(|side| side as u32);
    layout::View {
        row_x,
        width,
        row_y,
        height,
        row_z,
        count: count as u32,
        position: camera.position,
        capacity: capacity as u32,
        focal: camera.focal,
        center: camera.center,
        tangent_min: camera.tangent_min,
        tangent_max: camera.tangent_max,
        frustum_middle: frustum.middle,
        frustum_half: frustum.half,
        frustum_reach: frustum.reach,
        tile_columns: width.div_ceil(TILE),
        tile_rows: height.div_ceil(TILE),
        set_start: NONE,
        padding_0: 0,
        padding_1: [0.0; 2],
    }
}

/// The loss's uniform for a target. Weights of means over no pixels are zero.
pub fn loss_uniform(settings: &LossSettings, target: &Target) -> layout::Loss {
    let (width, height) = (target.color().width(), target.color().height());
    let colors = 3 * target.compared_colors(settings);
    let mean = |weight: f32, count: usize| match count {
        0 => 0.0,
        count => weight / count as f32,
    };
    layout::Loss {
        l1: mean(settings.l1_weight, colors),
        ssim: mean(settings.ssim_weight, colors),
        depth: mean(settings.depth_weight / DEPTH_UNIT_M, target.measured()),
        scale: settings.scale_weight,
        masked: settings.mask_color_by_depth.into(),
        normalize_depth: settings.normalize_depth.into(),
        columns: (width as u32).div_ceil(LOSS_SIDE),
        rows: (height as u32).div_ceil(LOSS_SIDE),
    }
}

impl Recorder<'_> {
    /// From gaussians to splats, tile lists and images.
    pub fn forward(&mut self, view: &layout::View) -> Result<(), GpuError> {
        self.project(view)?;
        self.make_lists(view)?;
        self.run("forward", Groups::Fixed(view.tile_columns, view.tile_rows))
    }

    /// From images and the target of the view with this visibility set to the gaussians' gradients.
    pub fn backward(
        &mut self,
        view: &layout::View,
        loss: &layout::Loss,
        set: u32,
    ) -> Result<(), GpuError> {
        let by_loss = Groups::Fixed(loss.columns, loss.rows);
        for stage in ["ssim", "losses"] {
            self.run_as(stage, set as usize, &[], by_loss)?;
        }
        self.run("backward", Groups::Fixed(view.tile_columns, view.tile_rows))?;
        self.run("project_vjp", Groups::Counted(Dispatch::PER_VISIBLE))
    }

    /// An Adam step, and the sum of the loss.
    pub fn optimize(&mut self) -> Result<(), GpuError> {
        self.run("adam", Groups::Counted(Dispatch::PER_VISIBLE))?;
        self.run("step_stats", Groups::Fixed(1, 1))
    }

    fn project(&mut self, view: &layout::View) -> Result<(), GpuError> {
        let by_gaussian = groups(view.count as usize);
        self.run("count_in_view", by_gaussian)?;
        self.run("place_in_view", Groups::Fixed(1, 1))?;
        self.run("project", by_gaussian)
    }

    fn make_lists(&mut self, view: &layout::View) -> Result<(), GpuError> {
        let (depths, by_visible) = (
            Dispatch::SORT_VISIBLE,
            Groups::Counted(Dispatch::PER_VISIBLE),
        );
        self.sort(&DEPTH_PASSES, depths, ["depth_keys", "order"])?;
        self.run("count_touches", by_visible)?;
        self.run("place_touches", Groups::Fixed(1, 1))?;
        self.run("write_touches", by_visible)?;
        let tiles = (view.tile_columns * view.tile_rows) as usize;
        // Keys go up to the number of tiles, one digit is 8 bits. The number of passes is even, so
        // that the result ends up in the input's buffers.
        let passes = if tiles < 1 << 16 { 2 } else { 4 };
        let tile_passes = &TILE_PASSES[..passes];
        self.sort(tile_passes, Dispatch::SORT_ENTRIES, ["tile_keys", "slots"])?;
        self.run("find_ranges", groups(tiles))
    }

    /// Radix sort of keys and values in place, least significant digit first.
    fn sort(
        &mut self,
        passes: &[&'static str],
        blocks: Dispatch,
        [keys, values]: [&'static str; 2],
    ) -> Result<(), GpuError> {
        let sorted = [format!("{keys}_sorted"), format!("{values}_sorted")];
        for (number, pass) in passes.iter().enumerate() {
            let mut from = [keys, values];
            let mut to = [&*sorted[0], &*sorted[1]];
            if number % 2 == 1 {
                std::mem::swap(&mut from, &mut to);
            }
            let aliases = [
                ("pass_", *pass),
                ("keys_in", from[0]),
                ("values_in", from[1]),
                ("keys_out", to[0]),
                ("values_out", to[1]),
            ];
            let variant = DEPTH_PASSES.len() * blocks as usize + number;
            self.run_as("count_digits", variant, &aliases, Groups::Counted(blocks))?;
            self.run_as("place_digits", variant, &aliases, Groups::Fixed(GROUP, 1))?;
            self.run_as("move_keys", variant, &aliases, Groups::Counted(blocks))?;
        }
        Ok(())
    }
}
