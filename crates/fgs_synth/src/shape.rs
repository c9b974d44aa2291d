//! Ray intersection with analytic solids: boxes, ellipsoids and capped cones in any orientation.
//!
//! Every face has texture coordinates (u, v) in metres, from 0 to the size of the face, for
//! patterns and baked light. `place` maps (u, v) to a point, `locate` is its inverse.

use std::f64::consts::{FRAC_PI_2, PI};

use nalgebra::{Matrix3, Rotation3, Vector3};

/// A ray, whose points are `origin + t direction`. The direction need not have unit length.
#[derive(Clone, Copy)]
pub(crate) struct Ray {
    pub origin: Vector3<f64>,
    pub direction: Vector3<f64>,
}

impl Ray {
    pub fn at(&self, t: f64) -> Vector3<f64> {
        self.origin + self.direction * t
    }
}

/// Directions all over the sphere, on a Fibonacci lattice.
#[cfg(test)]
pub(crate) fn directions() -> impl Iterator<Item = Vector3<f64>> {
    (0..200).map(|i| {
        let z = (f64::from(i) + 0.5) / 100.0 - 1.0;
        let (sin, cos) = (2.399_963 * f64::from(i)).sin_cos();
        let r = (1.0 - z * z).sqrt();
        Vector3::new(r * cos, r * sin, z)
    })
}

/// The shape of a solid in its local frame, centred at the origin.
#[derive(Clone, Copy)]
pub(crate) enum Form {
    /// A box. Faces 0 to 5: -x, +x, -y, +y, -z, +z.
    Block,
    /// An ellipsoid. Its only face is 0; u runs along the longitude, v along the latitude.
    Ball,
    /// A circular truncated cone or cylinder along z with these radii at its ends. Faces 0 to 2:
    /// side, bottom, top.
    Frustum { bottom: f64, top: f64 },
}

/// A form with its half extents and its pose in the world.
#[derive(Clone)]
pub(crate) struct Solid {
    form: Form,
    half: Vector3<f64>,
    center: Vector3<f64>,
    world_from_local: Matrix3<f64>,
    local_from_world: Matrix3<f64>,
}

/// A point on a face.
pub(crate) struct FacePoint {
    /// Texture coordinates, metres, from `[0, 0]` to `size`.
    pub uv: [f64; 2],
    /// Extents of the face, metres.
    pub size: [f64; 2],
    /// Outward unit normal in the world frame.
    pub normal: Vector3<f64>,
}

impl Solid {
    pub fn new(
        form: Form,
        half: Vector3<f64>,
        center: Vector3<f64>,
        world_from_local: Rotation3<f64>,
    ) -> Self {
        let world_from_local = world_from_local.into_inner();
        Self {
            form,
            half,
            center,
            world_from_local,
            local_from_world: world_from_local.transpose(),
        }
    }

    pub fn face_count(&self) -> usize {
        match self.form {
            Form::Block => 6,
            Form::Ball => 1,
            Form::Frustum { .. } => 3,
        }
    }

    /// Lowest and highest corner of the axis-aligned bounding box.
    pub fn bounds(&self) -> [Vector3<f64>; 2] {
        let reach = self.world_from_local.abs() * self.half;
        [self.center - reach, self.center + reach]
    }

    /// The first intersection with the surface, from outside or inside, with t in (`t_min`,
    /// `t_max`), as (t, face).
    #[inline]
    pub fn meet(&self, ray: &Ray, t_min: f64, t_max: f64) -> Option<(f64, usize)> {
        let origin = self.local_from_world * (ray.origin - self.center);
        let direction = self.local_from_world * ray.direction;
        let first = |roots: [(f64, usize); 2]| {
            roots
                .into_iter()
                .find(|&(t, _)| t > t_min)
                .filter(|&(t, _)| t < t_max)
        };
        match self.form {
            Form::Block => first(meet_block(&self.half, &origin, &direction)?),
            Form::Ball => first(meet_ball(&self.half, &origin, &direction)?),
            Form::Frustum { bottom, top } => {
                let hits = meet_frustum(bottom, top, self.half.z, &origin, &direction);
                (hits.into_iter().filter(|&(t, _)| t > t_min && t < t_max))
                    .min_by(|a, b| a.0.total_cmp(&b.0))
            }
        }
    }

    /// The point at `uv` on a face and its outward unit normal, in the world frame.
    pub fn place(&self, face: usize, [u, v]: [f64; 2]) -> (Vector3<f64>, Vector3<f64>) {
        let half = &self.half;
        let (point, normal) = match self.form {
            Form::Block => {
                let (axis, sign) = (face / 2, if face % 2 == 1 { 1.0 } else { -1.0 });
                let (u_axis, u_sign, v_axis) = block_axes(face);
                let mut point = Vector3::zeros();
                point[axis] = sign * half[axis];
                point[u_axis] = u_sign * (u - half[u_axis]);
                point[v_axis] = v - half[v_axis];
                (point, Vector3::ith(axis, sign))
            }
            Form::Ball => {
                let (longitude, latitude) = (u / half.x - PI, v / half.z - FRAC_PI_2);
                let on_unit = Vector3::new(
                    latitude.cos() * longitude.cos(),
                    latitude.cos() * longitude.sin(),
                    latitude.sin(),
                );
                let normal = on_unit.component_div(half).normalize();
                (on_unit.component_mul(half), normal)
            }
            Form::Frustum { bottom, top } => match face {
                0 => {
                    let (sin, cos) = (2.0 * u / (bottom + top) - PI).sin_cos();
                    let radius = bottom + (top - bottom) * v / (2.0 * half.z);
                    let slope = (top - bottom) / (2.0 * half.z);
                    let point = Vector3::new(radius * cos, radius * sin, v - half.z);
                    (point, Vector3::new(cos, sin, -slope).normalize())
                }
                1 => (Vector3::new(u - bottom, v - bottom, -half.z), -Vector3::z()),
                _ => (Vector3::new(u - top, v - top, half.z), Vector3::z()),
            },
        };
        (
            self.center + self.world_from_local * point,
            self.world_from_local * normal,
        )
    }

    /// Texture coordinates and normal at a world point on a face.
    pub fn locate(&self, face: usize, point: &Vector3<f64>) -> FacePoint {
        let half = &self.half;
        let p = self.local_from_world * (point - self.center);
        let size = self.face_size(face);
        let (uv, normal) = match self.form {
            Form::Block => {
                let (u_axis, u_sign, v_axis) = block_axes(face);
                let uv = [u_sign * p[u_axis] + half[u_axis], p[v_axis] + half[v_axis]];
                (
                    uv,
                    Vector3::ith(face / 2, if face % 2 == 1 { 1.0 } else { -1.0 }),
                )
            }
            Form::Ball => {
                let on_unit = p.component_div(half);
                let longitude = on_unit.y.atan2(on_unit.x);
                let latitude = on_unit.z.clamp(-1.0, 1.0).asin();
                let uv = [half.x * (longitude + PI), half.z * (latitude + FRAC_PI_2)];
                (uv, on_unit.component_div(half).normalize())
            }
            Form::Frustum { bottom, top } => match face {
                0 => {
                    let angle = p.y.atan2(p.x);
                    let slope = (top - bottom) / (2.0 * half.z);
                    let uv = [0.5 * (bottom + top) * (angle + PI), p.z + half.z];
                    (
                        uv,
                        Vector3::new(angle.cos(), angle.sin(), -slope).normalize(),
                    )
                }
                1 => ([p.x + bottom, p.y + bottom], -Vector3::z()),
                _ => ([p.x + top, p.y + top], Vector3::z()),
            },
        };
        FacePoint {
            uv,
            size,
            normal: self.world_from_local * normal,
        }
    }

    /// Extents of a face, metres.
    pub fn face_size(&self, face: usize) -> [f64; 2] {
        let half = &self.half;
        match self.form {
            Form::Block => {
                let (u_axis, _, v_axis) = block_axes(face);
                [2.0 * half[u_axis], 2.0 * half[v_axis]]
            }
            Form::Ball => [2.0 * PI * half.x, PI * half.z],
            Form::Frustum { bottom, top } => match face {
                0 => [PI * (bottom + top), 2.0 * half.z],
                1 => [2.0 * bottom; 2],
                _ => [2.0 * top; 2],
            },
        }
    }
}

/// Texture axes of a block's face: the axis of u, its sign, and the axis of v. Seen from outside,
/// u points right and v up.
fn block_axes(face: usize) -> (usize, f64, usize) {
    match face {
        0 => (1, -1.0, 2),
        1 => (1, 1.0, 2),
        2 => (0, 1.0, 2),
        3 => (0, -1.0, 2),
        4 => (0, -1.0, 1),
        _ => (0, 1.0, 1),
    }
}

/// Where a line enters and leaves a block, by the slab method.
#[inline]
fn meet_block(
    half: &Vector3<f64>,
    origin: &Vector3<f64>,
    direction: &Vector3<f64>,
) -> Option<[(f64, usize); 2]> {
    let mut enter = (f64::NEG_INFINITY, 0);
    let mut leave = (f64::INFINITY, 0);
    for axis in 0..3 {
        let inverse = 1.0 / direction[axis];
        let (low, high) = (
            ((-half[axis] - origin[axis]) * inverse, 2 * axis),
            ((half[axis] - origin[axis]) * inverse, 2 * axis + 1),
        );
        let (near, far) = if inverse >= 0.0 {
            (low, high)
        } else {
            (high, low)
        };
        // 0 / 0 arises for a line that lies in the plane of a face. Comparisons with NaN are false,
        // so that slab then imposes no bound.
        if near.0 > enter.0 {
            enter = near;
        }
        if far.0 < leave.0 {
            leave = far;
        }
    }
    (enter.0 < leave.0).then_some([enter, leave])
}

/// Where a line enters and leaves an ellipsoid: a quadratic, after scaling it to the unit sphere.
fn meet_ball(
    half: &Vector3<f64>,
    origin: &Vector3<f64>,
    direction: &Vector3<f64>,
) -> Option<[(f64, usize); 2]> {
    let (o, d) = (origin.component_div(half), direction.component_div(half));
    let roots = quadratic(d.norm_squared(), o.dot(&d), o.norm_squared() - 1.0)?;
    Some(roots.map(|t| (t, 0)))
}

/// Intersections of a line with the side (twice) and the two caps of a truncated cone; infinity
/// for a miss.
fn meet_frustum(
    bottom: f64,
    top: f64,
    half_height: f64,
    o: &Vector3<f64>,
    d: &Vector3<f64>,
) -> [(f64, usize); 4] {
    const NONE: f64 = f64::INFINITY;
    // The side is x^2 + y^2 = r(z)^2 with r(z) = (bottom + top) / 2 + slope z.
    let slope = (top - bottom) / (2.0 * half_height);
    let radius = 0.5 * (bottom + top) + slope * o.z;
    let roots = quadratic(
        d.x * d.x + d.y * d.y - slope * slope * d.z * d.z,
        o.x * d.x + o.y * d.y - slope * d.z * radius,
        o.x * o.x + o.y * o.y - radius * radius,
    );
    let [a, b] = roots.map_or([NONE; 2], |roots| {
        roots.map(|t| {
            if (o.z + t * d.z).abs() <= half_height {
                t
            } else {
                NONE
            }
        })
    });
    let cap = |z: f64, radius: f64| {
        let t = (z - o.z) / d.z;
        let inside = (o.x + t * d.x).powi(2) + (o.y + t * d.y).powi(2) <= radius * radius;
        if inside { t } else { NONE }
    };
    [
        (a, 0),
        (b, 0),
        (cap(-half_height, bottom), 1),
        (cap(half_height, top), 2),
    ]
}

/// Real roots of a t^2 + 2 b t + c in ascending order.
fn quadratic(a: f64, b: f64, c: f64) -> Option<[f64; 2]> {
    let discriminant = b * b - a * c;
    // Negated so that NaN, like a = 0, yields no roots.
    if !(discriminant > 0.0 && a != 0.0) {
        return None;
    }
    let root = discriminant.sqrt();
    let (s, t) = ((-b - root) / a, (-b + root) / a);
    Some(if s < t { [s, t] } else { [t, s] })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn solids() -> Vec<Solid> {
        let turn = Rotation3::from_euler_angles(0.3, -0.5, 0.9);
        let center = Vector3::new(0.5, -0.2, 1.0);
        [
            (Form::Block, Vector3::new(0.3, 0.5, 0.2)),
            (Form::Ball, Vector3::new(0.3, 0.5, 0.2)),
            (
                Form::Frustum {
                    bottom: 0.4,
                    top: 0.1,
                },
                Vector3::new(0.4, 0.4, 0.5),
            ),
        ]
        .map(|(form, half)| Solid::new(form, half, center, turn))
        .to_vec()
    }

    #[test]
    fn rays_meet_the_face_point_they_aim_at() {
        for solid in solids() {
            for face in 0..solid.face_count() {
                let size = solid.face_size(face);
                let uv = [0.55 * size[0], 0.4 * size[1]];
                let (point, normal) = solid.place(face, uv);
                let back = solid.locate(face, &point);
                assert!((back.uv[0] - uv[0]).abs() <= 1e-12);
                assert!((back.uv[1] - uv[1]).abs() <= 1e-12);
                assert!((back.normal - normal).amax() <= 1e-12);

                let origin = point + 2.0 * normal + Vector3::new(0.1, 0.05, -0.1);
                let ray = Ray {
                    origin,
                    direction: point - origin,
                };
                let (t, met) = solid.meet(&ray, 0.0, f64::INFINITY).unwrap();
                assert!((t - 1.0).abs() <= 1e-12);
                assert_eq!(met, face);
                assert!(solid.meet(&ray, 0.0, 0.9).is_none());
                let [low, high] = solid.bounds();
                assert!(point >= low.add_scalar(-1e-12) && point <= high.add_scalar(1e-12));
            }
        }
    }

    #[test]
    fn normals_point_out_and_are_the_surface_gradient() {
        for solid in solids() {
            for face in 0..solid.face_count() {
                let size = solid.face_size(face);
                let at =
                    |du: f64, dv: f64| solid.place(face, [0.3 * size[0] + du, 0.6 * size[1] + dv]);
                let (point, normal) = at(0.0, 0.0);
                let (along_u, along_v) = (at(1e-6, 0.0).0 - point, at(0.0, 1e-6).0 - point);
                assert!(along_u.dot(&normal).abs() <= 1e-11);
                assert!(along_v.dot(&normal).abs() <= 1e-11);
                assert!(normal.dot(&(point - solid.center)) > 0.0);
            }
        }
    }

    #[test]
    fn misses_and_rays_from_inside() {
        for solid in solids() {
            let direction = Vector3::new(0.1, 0.9, 0.3);
            let inside = Ray {
                origin: solid.center,
                direction,
            };
            assert!(solid.meet(&inside, 0.0, f64::INFINITY).is_some());
            let away = Ray {
                origin: solid.center + 3.0 * direction,
                direction,
            };
            assert!(solid.meet(&away, 0.0, f64::INFINITY).is_none());
        }
    }
}
