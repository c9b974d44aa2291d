//! A camera's topics as a live camera.

use std::path::PathBuf;
use std::thread::sleep;
use std::time::{Duration, Instant};

use fgs_data::{CameraFile, CameraSource, DataError, LiveImages};
use fgs_recordings::{ImageTopic, RosCamera, stamp_secs};

use crate::error::Ros2Error;
use crate::node::{Domain, Published};
use crate::pairs::{Pairs, Stamped};
use crate::publisher::Ros2Publisher;
use crate::raw_topic::RawReader;
use crate::topics::Topics;

/// The camera's driver may be starting.
const PATIENCE: Duration = Duration::from_secs(20);

/// How often topics are looked at: a fraction of the time between frames.
const GLANCE: Duration = Duration::from_millis(2);

/// After so long without an image the publishers may be gone.
const SILENCE: Duration = Duration::from_secs(5);

/// Images of a camera of ROS 2.
pub struct Ros2Camera {
    domain: Domain,
    topics: Topics,
    readers: [RawReader; 2],
    pairs: Pairs,
    camera: RosCamera,
    /// What messages call it.
    path: PathBuf,
}

/// Waits for a camera's topics and their first images; see the crate.
///
/// # Errors
/// If nothing comes for 20 s, or what comes does not fit together.
pub fn open(domain: Domain, topics: &Topics) -> Result<(Ros2Camera, Ros2Publisher), Ros2Error> {
    let publisher = Ros2Publisher::new(&domain)?;
    let begin = Instant::now();
    let [color, depth, info] = [&topics.color, &topics.depth, &topics.info];
    let names = [color, depth, info];
    let published = loop {
        let published = domain.published();
        let find = |name: &String| published.iter().find(|it| it.topic == *name);
        if let [Some(color), Some(depth), Some(info)] = names.map(find) {
            break [color, depth, info].map(|it| it.is_reliable);
        }
        if begin.elapsed() > PATIENCE {
            return Err(not_published(&names.map(String::as_str), &published));
        }
        sleep(GLANCE);
    };
    let reader = |topic: &str, name: &str, is_reliable: bool| {
        domain.reader(topic, ("sensor_msgs", name), is_reliable)
    };
    let images = |topic: &str, is_reliable: bool| {
        let is_compressed = Topics::is_compressed(topic);
        let name = if is_compressed {
            "CompressedImage"
        } else {
            "Image"
        };
        reader(topic, name, is_reliable)
    };
    let readers = [images(color, published[0])?, images(depth, published[1])?];
    let infos = reader(info, "CameraInfo", published[2])?;
    let path = PathBuf::from("ROS 2");
    let mut pairs = Pairs::default();
    let (mut first_info, mut first_pair) = (None, None);
    let mut came = [false; 3];
    loop {
        take(&readers, &mut pairs, &mut came)?;
        if let Some(message) = next_message(&infos)? {
            came[2] = true;
            first_info = Some(message);
        }
        first_pair = pairs.next().or(first_pair);
        if let (Some(info), Some([color_image, depth_image])) = (&first_info, &first_pair) {
            let of = |name: &str, image: &Stamped| {
                ImageTopic::of(&path, name, Topics::is_compressed(name), &image.message)
            };
            let (color, depth) = (of(color, color_image)?, of(depth, depth_image)?);
            let camera = RosCamera::open(&path, info, color, depth)?;
            let camera = Ros2Camera {
                domain,
                topics: topics.clone(),
                readers,
                pairs,
                camera,
                path,
            };
            return Ok((camera, publisher));
        }
        if begin.elapsed() > PATIENCE {
            return Err(Ros2Error::Silent(silence(&names.map(String::as_str), came)));
        }
        sleep(GLANCE);
    }
}

fn not_published(names: &[&str; 3], published: &[Published]) -> Ros2Error {
    let missing = names
        .iter()
        .filter(|name| published.iter().all(|it| it.topic != **name));
    let missing: Vec<&str> = missing.copied().collect();
    let mut images: Vec<&str> = published
        .iter()
        .filter(|it| it.type_name.ends_with("Image_"))
        .map(|it| it.topic.as_str())
        .collect();
    images.sort_unstable();
    images.dedup();
    let images = if images.is_empty() {
        "none".into()
    } else {
        images.join(", ")
    };
    Ros2Error::Silent(format!(
        "nobody publishes {} (topics with images: {images})",
        missing.join(", ")
    ))
}

fn silence(names: &[&str; 3], came: [bool; 3]) -> String {
    let silent = names.iter().zip(came).filter(|(_, came)| !came);
    let silent: Vec<&str> = silent.map(|(name, _)| *name).collect();
    if silent.is_empty() {
        format!(
            "no image of {} was taken when one of {} was",
            names[0], names[1]
        )
    } else {
        format!("no message came of {}", silent.join(", "))
    }
}

/// Takes what has come of both topics.
fn take(readers: &[RawReader; 2], pairs: &mut Pairs, came: &mut [bool]) -> Result<(), Ros2Error> {
    for (i, reader) in readers.iter().enumerate() {
        while let Some(message) = next_message(reader)? {
            came[i] = true;
            // What has no header was never taken.
            let Some(secs) = stamp_secs(&message) else {
                continue;
            };
            let image = Stamped { secs, message };
            if i == 0 {
                pairs.add_color(image);
            } else {
                pairs.add_depth(image);
            }
        }
    }
    Ok(())
}

fn next_message(reader: &RawReader) -> Result<Option<Vec<u8>>, Ros2Error> {
    reader.drain_read_notifications();
    let sample = reader.try_take_one().map_err(Ros2Error::ros)?;
    Ok(sample.map(|sample| sample.into_value()))
}

impl Ros2Camera {
    /// Whether the topics' publishers are still there.
    fn is_there(&self) -> bool {
        let published = self.domain.published();
        let is_published = |name: &String| published.iter().any(|it| it.topic == *name);
        is_published(&self.topics.color) && is_published(&self.topics.depth)
    }

    fn damage(&self, error: &Ros2Error) -> DataError {
        DataError::Recording {
            path: self.path.clone(),
            message: error.to_string(),
        }
    }
}

impl CameraSource for Ros2Camera {
    fn camera_file(&self) -> &CameraFile {
        self.camera.camera_file()
    }

    /// Ends when nobody publishes the topics any more.
    fn next_images(&mut self) -> Option<Result<LiveImages, DataError>> {
        let mut last = Instant::now();
        loop {
            let mut came = [false; 2];
            if let Err(error) = take(&self.readers, &mut self.pairs, &mut came) {
                return Some(Err(self.damage(&error)));
            }
            if let Some([color, depth]) = self.pairs.next() {
                let images = self
                    .camera
                    .images(&self.path, &color.message, &depth.message);
                return Some(images.map(|images| LiveImages {
                    timestamp_secs: color.secs,
                    images,
                }));
            }
            if last.elapsed() > SILENCE {
                if !self.is_there() {
                    return None;
                }
                last = Instant::now();
            }
            sleep(GLANCE);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_missing_is_named() {
        let names = ["/c/color", "/c/depth", "/c/info"];
        let published = |topic: &str, type_name: &str| Published {
            topic: topic.into(),
            type_name: type_name.into(),
            is_reliable: true,
        };
        let others = [
            published("/d/rgb", "sensor_msgs::msg::dds_::Image_"),
            published("/c/color", "sensor_msgs::msg::dds_::CompressedImage_"),
            published("/rosout", "rcl_interfaces::msg::dds_::Log_"),
        ];
        let message = not_published(&names, &others).to_string();
        let expected = "nobody publishes /c/depth, /c/info (topics with images: /c/color, /d/rgb)";
        assert_eq!(message, expected);
        let message = silence(&names, [true, false, true]);
        assert_eq!(message, "no message came of /c/depth");
        let message = silence(&names, [true; 3]);
        assert_eq!(
            message,
            "no image of /c/color was taken when one of /c/depth was"
        );
    }
}
