//! A click on the object, where several things stand on the table.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// A pixel of a photo that shows the object: `X,Y@PHOTO`, pixels from the left and upper edge of the photo's file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct ObjectClick {
    /// Name of the photo, with or without its folders.
    pub photo: String,
    /// The pixel; the centre of the first one is (0.5, 0.5).
    pub pixel: [f64; 2],
}

impl FromStr for ObjectClick {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let wrong = || format!("\"{text}\" is no click: expected a pixel and a photo, such as 512,300@IMG_1001.jpg");
        let (pixel, photo) = text.split_once('@').ok_or_else(wrong)?;
        let (x, y) = pixel.split_once(',').ok_or_else(wrong)?;
        let number = |t: &str| t.trim().parse().ok().filter(|v: &f64| v.is_finite() && *v >= 0.0).ok_or_else(wrong);
        let photo = photo.trim();
        if photo.is_empty() {
            return Err(wrong());
        }
        Ok(Self { photo: photo.to_owned(), pixel: [number(x)?, number(y)?] })
    }
}

impl TryFrom<String> for ObjectClick {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl From<ObjectClick> for String {
    fn from(click: ObjectClick) -> Self {
        click.to_string()
    }
}

impl fmt::Display for ObjectClick {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{},{}@{}", self.pixel[0], self.pixel[1], self.photo)
    }
}
