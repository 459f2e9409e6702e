//! Advice from the test results of all adapters: the engine that each `--backend` uses, and how to fix problems.

/// The test result of an adapter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AdapterState {
    /// All images are correct.
    Right,
    /// It opens, but draws wrong images.
    Wrong,
    /// It cannot be opened.
    Unusable,
}

/// A tested adapter.
#[derive(Clone, Copy, Debug)]
pub struct AdapterTrial {
    /// True for a hardware GPU.
    pub hardware: bool,
    /// The test result.
    pub state: AdapterState,
}

/// All adapters of a machine.
#[derive(Clone, Debug, Default)]
pub struct Machine {
    /// The adapters in the driver's order.
    pub tried: Vec<AdapterTrial>,
    /// Index of the adapter that `--backend auto` uses.
    pub auto: Option<usize>,
    /// Index of the adapter that `--backend gpu` uses.
    pub any: Option<usize>,
    /// `VARIABLE=value` of the environment variable that sets the drivers of the Vulkan loader.
    pub drivers: Option<String>,
    /// `VARIABLE=value` of the environment variable that disables drivers of the Vulkan loader.
    pub disabled: Option<String>,
}

impl Machine {
    fn at(&self, place: Option<usize>) -> Option<AdapterTrial> {
        place.and_then(|i| self.tried.get(i).copied())
    }

    /// Returns false if an adapter draws wrong images, or one that would be used cannot be opened.
    pub fn is_sound(&self) -> bool {
        let used = [self.auto, self.any].map(|place| self.at(place).map(|t| t.state));
        !self.tried.iter().any(|t| t.state == AdapterState::Wrong) && !used.contains(&Some(AdapterState::Unusable))
    }

    /// The advice, one line per `--backend` and problem.
    pub fn advice(&self) -> String {
        let auto = match self.at(self.auto).map(|t| t.state) {
            Some(AdapterState::Right) => "--backend auto takes the GPU.",
            Some(AdapterState::Wrong) => "--backend auto takes the GPU, unless it draws the requested images wrong.",
            Some(AdapterState::Unusable) => "--backend auto takes the CPU engine: the GPU cannot be opened.",
            None => "--backend auto takes the CPU engine: no hardware GPU was found.",
        };
        let mut lines = vec![auto.to_owned(), self.of_any()];
        if self.tried.iter().any(|t| t.state == AdapterState::Wrong) {
            lines.push(
                "Update the driver of each adapter with errors above, or use --backend cpu, and please report it."
                    .to_owned(),
            );
        }
        lines.join("\n")
    }

    /// Advice for `--backend gpu`.
    fn of_any(&self) -> String {
        let text = match self.at(self.any) {
            Some(AdapterTrial { state: AdapterState::Unusable, .. }) => {
                "--backend gpu ends with status 3: the adapter that it takes cannot be opened. Free the resource named \
                 in the message above (for memory, also check ulimit -v), or update the driver, or use --backend cpu."
            }
            Some(AdapterTrial { state: AdapterState::Wrong, .. }) => {
                "--backend gpu ends with status 3 if its adapter draws wrong images."
            }
            Some(AdapterTrial { hardware: false, .. }) => {
                "--backend gpu takes a software GPU: slower than the CPU engine, good for tests."
            }
            Some(AdapterTrial { hardware: true, .. }) => "Nothing needs to be installed.",
            None => return self.of_none(),
        };
        text.to_owned()
    }

    /// Advice if `--backend gpu` finds no adapter.
    fn of_none(&self) -> String {
        if !self.tried.is_empty() {
            return "--backend gpu finds no usable adapter: the adapters above can bind too few buffers.".into();
        }
        if let Some(set) = &self.disabled {
            return format!(
                "--backend gpu finds nothing. {set} is set, which disables drivers of these names. Unset it."
            );
        }
        match &self.drivers {
            Some(set) => format!(
                "--backend gpu finds nothing. {set} is set, so drivers are loaded only from there. Unset it, or set it \
                 to a driver's JSON file."
            ),
            None if cfg!(target_os = "linux") => {
                "--backend gpu finds nothing. For a GPU install its Vulkan driver (NVIDIA's, or mesa-vulkan-drivers \
                 and libvulkan1 on Debian and Ubuntu, which include lavapipe, a software GPU)."
                    .into()
            }
            None => "--backend gpu finds nothing. Install the GPU's driver.".into(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn machine(hardware: Option<AdapterState>, software: Option<AdapterState>) -> Machine {
        let one = |hardware, state: Option<AdapterState>| state.map(|state| AdapterTrial { hardware, state });
        let tried: Vec<AdapterTrial> = one(false, software).into_iter().chain(one(true, hardware)).collect();
        let auto = tried.iter().position(|t| t.hardware);
        Machine { any: auto.or(tried.first().map(|_| 0)), auto, tried, ..Machine::default() }
    }

    #[test]
    fn advice_follows_what_can_be_used() {
        use AdapterState::{Right, Unusable, Wrong};
        for (hardware, software, sound, told, untold) in [
            (None, None, true, "no hardware GPU was found.\n--backend gpu finds nothing", "takes the GPU"),
            (None, Some(Right), true, "takes a software GPU", "status 3"),
            (None, Some(Unusable), false, "--backend gpu ends with status 3: the adapter", "software GPU"),
            (None, Some(Wrong), false, "Update the driver", "good for tests"),
            (Some(Right), None, true, "takes the GPU.\nNothing needs to be installed.", "CPU engine"),
            (Some(Right), Some(Unusable), true, "takes the GPU.\nNothing needs", "status 3"),
            (Some(Right), Some(Wrong), false, "Update the driver", "status 3"),
            (Some(Unusable), Some(Right), false, "the CPU engine: the GPU cannot be opened.", "takes the GPU"),
            (Some(Wrong), None, false, "unless it draws the requested images wrong", "Nothing needs"),
        ] {
            let machine = machine(hardware, software);
            let advice = machine.advice();
            assert_eq!(machine.is_sound(), sound, "{machine:?}");
            assert!(advice.contains(told) && !advice.contains(untold), "{machine:?}: {advice}");
        }
    }

    #[test]
    fn a_variable_that_hides_drivers_is_named() {
        let drivers = Some("VK_DRIVER_FILES=/nothing".to_owned());
        let told = |machine: Machine| Machine { drivers: drivers.clone(), ..machine }.advice();
        assert!(told(machine(None, None)).contains("VK_DRIVER_FILES=/nothing is set"));
        assert!(!told(machine(None, Some(AdapterState::Right))).contains("VK_DRIVER_FILES"));
        let disabled = Some("VK_LOADER_DRIVERS_DISABLE=*".to_owned());
        let told = Machine { disabled, ..machine(None, None) }.advice();
        assert!(told.contains("VK_LOADER_DRIVERS_DISABLE=* is set") && !told.contains("install"), "{told}");
    }
}
