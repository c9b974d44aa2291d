//! Which topics make a camera: `/camera`, or `color=TOPIC,depth=TOPIC[,info=TOPIC]`.

use std::str::FromStr;

/// The topics of a camera's messages.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Topics {
    /// Colour: `sensor_msgs/msg/Image`, or `CompressedImage` if its name ends with `/compressed`.
    pub color: String,
    /// Depth registered to it: the same, where compressed ones end with `/compressedDepth` too.
    pub depth: String,
    /// `sensor_msgs/msg/CameraInfo` of colour.
    pub info: String,
}

impl Topics {
    /// Whether a topic has compressed images.
    pub(crate) fn is_compressed(topic: &str) -> bool {
        topic.ends_with("/compressed") || topic.ends_with("/compressedDepth")
    }
}

impl FromStr for Topics {
    type Err = String;

    /// Parts are separated by commas. One without a key is the name that RealSense's topics begin with; keys
    /// take precedence. Without `info`, it is `camera_info` beside colour.
    fn from_str(text: &str) -> Result<Self, String> {
        let (mut color, mut depth, mut info) = (None, None, None);
        for part in text.split(',') {
            let (place, topic) = match part.split_once('=') {
                Some(("color", topic)) => (&mut color, topic.to_owned()),
                Some(("depth", topic)) => (&mut depth, topic.to_owned()),
                Some(("info", topic)) => (&mut info, topic.to_owned()),
                Some((key, _)) => {
                    return Err(format!("'{key}' is none of color, depth and info"));
                }
                None => {
                    let prefix = part.trim_end_matches('/');
                    check(prefix)?;
                    color.get_or_insert(format!("{prefix}/color/image_raw"));
                    depth.get_or_insert(format!("{prefix}/aligned_depth_to_color/image_raw"));
                    continue;
                }
            };
            check(&topic)?;
            *place = Some(topic);
        }
        let missing = |what| format!("no topic is given for {what}");
        let color = color.ok_or_else(|| missing("color"))?;
        let raw = color.strip_suffix("/compressed").unwrap_or(&color);
        let parent = raw.rsplit_once('/').map_or("", |(parent, _)| parent);
        Ok(Self {
            info: info.unwrap_or_else(|| format!("{parent}/camera_info")),
            depth: depth.ok_or_else(|| missing("depth"))?,
            color,
        })
    }
}

/// ROS's rules for absolute names.
fn check(topic: &str) -> Result<(), String> {
    let is_name = |part: &str| {
        let is_letter = |c: char| c.is_ascii_alphabetic() || c == '_';
        part.starts_with(is_letter) && part.chars().all(|c| is_letter(c) || c.is_ascii_digit())
    };
    match topic.strip_prefix('/') {
        Some(rest) if rest.split('/').all(is_name) => Ok(()),
        _ => Err(format!(
            "'{topic}' is not a topic such as /camera/color/image_raw"
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn topics(text: &str) -> Result<[String; 3], String> {
        let topics: Topics = text.parse()?;
        Ok([topics.color, topics.depth, topics.info])
    }

    #[test]
    fn names_of_a_realsense_camera() {
        let expected = [
            "/camera/color/image_raw",
            "/camera/aligned_depth_to_color/image_raw",
            "/camera/color/camera_info",
        ];
        for text in ["/camera", "/camera/"] {
            assert_eq!(topics(text).unwrap(), expected);
        }
    }

    #[test]
    fn keys_take_precedence() {
        let found = topics("/cam,depth=/d,info=/i").unwrap();
        assert_eq!(found, ["/cam/color/image_raw", "/d", "/i"]);
        let found = topics("color=/a/rgb/compressed,depth=/a/d").unwrap();
        assert_eq!(found, ["/a/rgb/compressed", "/a/d", "/a/camera_info"]);
    }

    #[test]
    fn what_is_no_topic_is_refused() {
        for text in [
            "",
            "camera",
            "/",
            "/a//b",
            "/a b",
            "/1a",
            "colour=/a",
            "color=/a",
            "depth=/a",
        ] {
            assert!(topics(text).is_err(), "{text}");
        }
    }
}
