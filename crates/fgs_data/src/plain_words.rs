//! What parsers of settings say, in words of the person who wrote the file.

/// A parser's message without names of types: `invalid type: string "far", expected f64` becomes
/// `"far" is given where a number is expected`.
pub fn plain_words(message: &str) -> String {
    let message = message.replace("unknown variant", "unknown choice");
    let Some((before, found, after)) = split(&message) else {
        return message;
    };
    let (expected, rest) = expected(after);
    let found = found_in_words(found);
    format!("{before}{found} is given where {expected} is expected{rest}")
}

/// What stands before the complaint, what was found, and what follows `expected`.
fn split(message: &str) -> Option<(&str, &str, &str)> {
    let starts = ["invalid type: ", "invalid value: ", "invalid length "];
    let (start, keyword) = starts
        .iter()
        .filter_map(|keyword| Some((message.find(keyword)?, keyword)))
        .min()?;
    let (found, after) = message[start..].rsplit_once(", expected ")?;
    let found = match *keyword {
        // Of a list.
        "invalid length " => found,
        _ => &found[keyword.len()..],
    };
    Some((&message[..start], found, after))
}

fn found_in_words(found: &str) -> String {
    if let Some(length) = found.strip_prefix("invalid length ") {
        return format!("a list of {length}");
    }
    let kinds = [
        "integer ",
        "floating point ",
        "string ",
        "boolean ",
        "character ",
    ];
    let value = kinds.iter().find_map(|kind| found.strip_prefix(kind));
    let text = value.unwrap_or(match found {
        "map" => "a table",
        "sequence" => "a list",
        "unit variant" | "newtype variant" | "unit value" | "null" => "something else",
        other => other,
    });
    let text = text
        .trim_end_matches(" as i128")
        .trim_end_matches(" as u128");
    text.replace('`', "")
}

/// What is expected, and the rest of the message.
fn expected(text: &str) -> (String, &str) {
    let lists = ["an array of length ", "a tuple of size "];
    if let Some(rest) = lists.iter().find_map(|list| text.strip_prefix(list)) {
        let end = rest
            .find(|c: char| !c.is_ascii_digit())
            .unwrap_or(rest.len());
        return (format!("a list of {} numbers", &rest[..end]), &rest[end..]);
    }
    if let Some(rest) = text.strip_prefix("struct ") {
        let end = rest.find(' ').unwrap_or(rest.len());
        return ("a table".into(), &rest[end..]);
    }
    let words = [
        ("usize", "a whole number, 0 or more,"),
        ("u64", "a whole number, 0 or more,"),
        ("u32", "a whole number, 0 or more,"),
        ("f64", "a number"),
        ("f32", "a number"),
        ("a boolean", "true or false"),
        ("string only", "a word"),
        ("path string", "a path"),
        ("a string", "text"),
        ("any valid TOML value", "a smaller number"),
    ];
    for (word, plain) in words {
        if let Some(rest) = text.strip_prefix(word) {
            return (plain.into(), rest);
        }
    }
    (text.into(), "")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_names_of_types_are_left() {
        for (message, plain) in [
            (
                "invalid type: string \"far\", expected f64",
                "\"far\" is given where a number is expected",
            ),
            (
                "invalid value: integer `-1`, expected usize in `seed`",
                "-1 is given where a whole number, 0 or more, is expected in `seed`",
            ),
            (
                "invalid type: unit variant, expected string only in `run.mode`",
                "something else is given where a word is expected in `run.mode`",
            ),
            (
                "invalid type: integer `99999999999999999999` as i128, expected any valid TOML value",
                "99999999999999999999 is given where a smaller number is expected",
            ),
            (
                "invalid length 2, expected an array of length 5",
                "a list of 2 is given where a list of 5 numbers is expected",
            ),
            (
                "invalid type: map, expected struct Keys in `camera`",
                "a table is given where a table is expected in `camera`",
            ),
            (
                "unknown variant `fast`, expected one of `lockstep`",
                "unknown choice `fast`, expected one of `lockstep`",
            ),
            ("missing field `fy`", "missing field `fy`"),
            ("invalid type: odd", "invalid type: odd"),
        ] {
            assert_eq!(plain_words(message), plain);
        }
    }
}
