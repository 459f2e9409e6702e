//! What reads predictions honours what was given up.
