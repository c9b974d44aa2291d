//! A map as a point cloud of ROS.

use fgs_splat::Gaussians;

use crate::messages::{Header, PointCloud2, PointField};

/// The most points of a cloud, evenly chosen from the map: 1.6 MB, what viewers and networks take once a
/// second.
const MAX_POINTS: usize = 100_000;

/// Bytes of a point: x, y, z and colour.
const POINT_BYTES: u32 = 16;

/// `PointField.FLOAT32`.
const FLOAT: u8 = 7;

/// Gaussians that are hardly seen are no points of a surface.
const MIN_OPACITY: f32 = 0.3;

/// The centres and colours of a map's gaussians.
pub(crate) fn cloud(map: &Gaussians, header: Header) -> PointCloud2 {
    let seen = (0..map.len()).filter(|i| map.opacity(*i) >= MIN_OPACITY);
    let step = map.len().div_ceil(MAX_POINTS).max(1);
    let mut data = Vec::new();
    for i in seen.step_by(step) {
        for value in map.means[i] {
            data.extend(value.to_le_bytes());
        }
        let [r, g, b] = map
            .rgb(i)
            .map(|c| (255.0 * c.clamp(0.0, 1.0)).round() as u8);
        // Viewers take the four bytes as a float.
        data.extend([b, g, r, 0]);
    }
    let fields = ["x", "y", "z", "rgb"].iter().zip(0..);
    let fields = fields.map(|(name, i)| PointField {
        name: (*name).into(),
        offset: 4 * i,
        datatype: FLOAT,
        count: 1,
    });
    let row_step = data.len() as u32;
    PointCloud2 {
        header,
        height: 1,
        width: row_step / POINT_BYTES,
        fields: fields.collect(),
        is_bigendian: false,
        point_step: POINT_BYTES,
        row_step,
        data,
        is_dense: true,
    }
}

#[cfg(test)]
mod tests {
    use fgs_splat::Gaussian;

    use super::*;

    fn map(len: usize) -> Gaussians {
        let mut map = Gaussians::default();
        for i in 0..len {
            map.push(&Gaussian {
                mean: [i as f32, 2.0, 3.0],
                quat: [1.0, 0.0, 0.0, 0.0],
                scales: [0.02; 3],
                // Every third one can hardly be seen.
                opacity: if i % 3 == 2 { 0.01 } else { 0.9 },
                rgb: [0.5, 1.0, 0.0],
            });
        }
        map
    }

    #[test]
    fn points_lie_where_gaussians_do() {
        let cloud = cloud(&map(4), Header::default());
        assert_eq!((cloud.width, cloud.height, cloud.data.len()), (3, 1, 48));
        let third = &cloud.data[32..48];
        let expected = [3.0_f32, 2.0, 3.0].map(f32::to_le_bytes);
        assert_eq!(third[..12], *expected.as_flattened());
        // Blue, green, red.
        assert_eq!(third[12..], [0, 255, 128, 0]);
    }

    #[test]
    fn large_maps_are_thinned() {
        let cloud = cloud(&map(3 * MAX_POINTS), Header::default());
        assert!(cloud.width as usize <= MAX_POINTS && cloud.width as usize > MAX_POINTS / 2);
    }
}
