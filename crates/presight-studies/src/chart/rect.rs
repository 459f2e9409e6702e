//! Placement of labels without overlap.

/// The pixels that a mark or label covers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Rect {
    pub left: i32,
    pub top: i32,
    right: i32,
    bottom: i32,
}

impl Rect {
    pub fn of_mark((x, y): (i32, i32)) -> Self {
        Self { left: x - 5, top: y - 5, right: x + 5, bottom: y + 5 }
    }

    /// Finds a free place for a label, line by line above and then below its mark. It overlaps if all are taken.
    pub fn beside((x, y): (i32, i32), label: &str, taken: &[Self]) -> Self {
        let (wide, high) = (7 * label.chars().count() as i32, 13);
        let at = |left: i32, top: i32| Self { left, top, right: left + wide, bottom: top + high };
        let lines = (0..12).map(|k| at(x + 7, y - 16 - high * k)).chain((0..3).map(|k| at(x + 7, y + 6 + high * k)));
        lines.into_iter().find(|room| !taken.iter().any(|t| t.overlaps(room))).unwrap_or(at(x + 7, y - 16))
    }

    fn overlaps(&self, other: &Self) -> bool {
        self.left < other.right && other.left < self.right && self.top < other.bottom && other.top < self.bottom
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_keep_off_each_other() {
        let mut taken = vec![Rect::of_mark((50, 90)); 6];
        for _ in 0..6 {
            let room = Rect::beside((50, 90), "table", &taken);
            assert!(!taken.iter().any(|t| t.overlaps(&room)), "{room:?} of {taken:?}");
            taken.push(room);
        }
    }
}
