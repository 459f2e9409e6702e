//! Assigns unique paths.

use std::collections::HashMap;

/// The paths taken so far.
#[derive(Debug, Default)]
pub struct Paths {
    /// With the number to try for its next repetition: starting from 2 each time would take quadratic time.
    next: HashMap<String, u32>,
}

impl Paths {
    /// Takes the wanted path, or the first free one of `#2`, `#3` and so on, and returns it.
    pub fn take(&mut self, wanted: String) -> String {
        let Some(mut number) = self.next.get(&wanted).copied() else {
            self.next.insert(wanted.clone(), 2);
            return wanted;
        };
        let free = loop {
            let name = format!("{wanted}#{number}");
            number += 1;
            if !self.next.contains_key(&name) {
                break name;
            }
        };
        self.next.insert(free.clone(), 2);
        self.next.insert(wanted, number);
        free
    }

    /// Takes the path; returns true if it was free.
    pub fn reserve(&mut self, path: &str) -> bool {
        let free = !self.next.contains_key(path);
        if free {
            self.next.insert(path.to_owned(), 2);
        }
        free
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn repeats_get_the_first_free_number() {
        let mut paths = Paths::default();
        let mut take = |wanted: &str| paths.take(wanted.to_owned());
        assert_eq!([take("a"), take("a"), take("a#3"), take("a"), take("a#2")], ["a", "a#2", "a#3", "a#4", "a#2#2"]);
        assert!(!paths.reserve("a#4") && paths.reserve("b") && !paths.reserve("b"));
    }
}
