//! Unit scenes with counts that follow from their geometry.
