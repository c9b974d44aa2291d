//! Rendering for the host: whole images, or one bit per pixel.

use bytemuck::pod_collect_to_vec;
use fgs_geom::{Image, View};

use super::device_map::DeviceMap;
use super::layout::{self, Count, PixelState};
use super::passes::{groups, view_uniform};
use super::readback::read_parts;
use super::recorder::Recorder;
use crate::GpuError;
use crate::Rendered;

/// Renders a view, then runs what `after` records; repeats both if the tile lists overflow. Nothing
/// may be in flight. Returns the counts, and of each buffer in `parts` that many leading bytes.
///
/// # Errors
/// If the device fails or is out of memory.
pub fn run<const N: usize>(
    map: &mut DeviceMap,
    view: &layout::View,
    after: impl Fn(&mut Recorder<'_>) -> Result<(), GpuError>,
    parts: [(&str, usize); N],
) -> Result<(Vec<u32>, [Vec<u8>; N]), GpuError> {
    loop {
        let view = layout::View {
            capacity: map.buffers.entries() as u32,
            ..*view
        };
        map.write("view", bytemuck::bytes_of(&view))?;
        let mut recorder = map.recorder(None);
        recorder.forward(&view)?;
        after(&mut recorder)?;
        recorder.submit();
        let mut wanted = vec![(map.buffers.get("counts")?, 0, 4 * Count::ALL.len())];
        for (name, bytes) in parts {
            wanted.push((map.buffers.get(name)?, 0, bytes));
        }
        let mut bytes = read_parts(map.device(), &wanted)?.into_iter();
        let counts: Vec<u32> = pod_collect_to_vec(&bytes.next().unwrap_or_default());
        map.clear_counts()?;
        if counts[Count::OVERFLOWED as usize] == 0 {
            let parts = std::array::from_fn(|_| bytes.next().unwrap_or_default());
            return Ok((counts, parts));
        }
        map.make_room_for_entries(counts[Count::ENTRIES_NEEDED as usize])?;
    }
}

/// Colour, depth and alpha as seen from a view.
///
/// # Errors
/// If the device fails or is out of memory.
pub fn render(map: &mut DeviceMap, view: &View) -> Result<Rendered, GpuError> {
    let (width, height) = (view.camera.width, view.camera.height);
    map.buffers.make_room_for_image(width, height)?;
    let uniform = view_uniform(view, map.len(), map.buffers.entries());
    let pixels = width * height;
    let parts = [
        ("rendered", size_of::<[f32; 4]>() * pixels),
        ("pixel_states", size_of::<PixelState>() * pixels),
    ];
    let (_, [shown, states]) = run(map, &uniform, |_| Ok(()), parts)?;
    let shown: Vec<[f32; 4]> = pod_collect_to_vec(&shown);
    let states: Vec<PixelState> = pod_collect_to_vec(&states);
    let mut rendered = Rendered::default();
    rendered.resize(width, height);
    for (color, [r, g, b, _]) in rendered.color.data_mut().iter_mut().zip(&shown) {
        *color = [*r, *g, *b];
    }
    for (depth_m, [.., depth]) in rendered.depth_m.data_mut().iter_mut().zip(&shown) {
        *depth_m = *depth;
    }
    for (alpha, state) in rendered.alpha.data_mut().iter_mut().zip(&states) {
        *alpha = 1.0 - state.transmittance;
    }
    Ok(rendered)
}

/// Where a view's alpha is below a limit. Reads back one bit per pixel.
///
/// # Errors
/// If the device fails or is out of memory.
pub fn see_through(
    map: &mut DeviceMap,
    view: &View,
    min_alpha: f32,
) -> Result<Image<bool>, GpuError> {
    let (width, height) = (view.camera.width, view.camera.height);
    map.buffers.make_room_for_image(width, height)?;
    let limit = layout::SeeThrough {
        min_alpha,
        pixels: (width * height) as u32,
    };
    map.write("see_through_", bytemuck::bytes_of(&limit))?;
    let uniform = view_uniform(view, map.len(), map.buffers.entries());
    let words = (width * height).div_ceil(32);
    let (_, [words]) = run(
        map,
        &uniform,
        |recorder| recorder.run("see_through", groups(words)),
        [("see_through_words", 4 * words)],
    )?;
    let words: Vec<u32> = pod_collect_to_vec(&words);
    Ok(Image::from_fn(width, height, |u, v| {
        let pixel = v * width + u;
        words[pixel / 32] >> (pixel % 32) & 1 == 1
    }))
}
