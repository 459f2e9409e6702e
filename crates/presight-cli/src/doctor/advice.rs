//! Which engine is taken on a machine, and what would help, from what became of its adapters.

/// What became of an adapter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AdapterState {
    /// It draws what it should.
    Right,
    /// It opens, and draws something wrong.
    Wrong,
    /// It cannot be opened.
    Unusable,
}

/// An adapter that was tried.
#[derive(Clone, Copy, Debug)]
pub struct AdapterTrial {
    /// It is a real GPU.
    pub hardware: bool,
    /// What became of it.
    pub state: AdapterState,
}

/// All adapters of a machine.
#[derive(Clone, Debug, Default)]
pub struct Machine {
    /// In the driver's order.
    pub tried: Vec<AdapterTrial>,
    /// Which of them `--backend auto` takes.
    pub auto: Option<usize>,
    /// Which of them `--backend gpu` takes.
    pub any: Option<usize>,
    /// `VARIABLE=value` if the environment tells the Vulkan loader where drivers are.
    pub drivers: Option<String>,
    /// The same if it tells the loader which drivers to pass over.
    pub disabled: Option<String>,
}

impl Machine {
    fn at(&self, place: Option<usize>) -> Option<AdapterTrial> {
        place.and_then(|i| self.tried.get(i).copied())
    }

    /// False if an adapter draws wrong, or one that would be used cannot be opened.
    pub fn is_sound(&self) -> bool {
        let used = [self.auto, self.any].map(|place| self.at(place).map(|t| t.state));
        !self.tried.iter().any(|t| t.state == AdapterState::Wrong) && !used.contains(&Some(AdapterState::Unusable))
    }

    /// What each `--backend` takes, and what would help, line by line.
    pub fn advice(&self) -> String {
        let auto = match self.at(self.auto).map(|t| t.state) {
            Some(AdapterState::Right) => "--backend auto takes the GPU.",
            Some(AdapterState::Wrong) => "--backend auto takes the GPU, unless it draws wrong what is asked of it.",
            Some(AdapterState::Unusable) => "--backend auto takes the CPU engine: the GPU cannot be opened.",
            None => "--backend auto takes the CPU engine: no hardware GPU was found.",
        };
        let mut lines = vec![auto.to_owned(), self.of_any()];
        if self.tried.iter().any(|t| t.state == AdapterState::Wrong) {
            lines.push(
                "Update the driver of what is wrong above, or use --backend cpu, and please report it.".to_owned(),
            );
        }
        lines.join("\n")
    }

    /// What `--backend gpu` takes.
    fn of_any(&self) -> String {
        let text = match self.at(self.any) {
            Some(AdapterTrial { state: AdapterState::Unusable, .. }) => {
                "--backend gpu ends with status 3: the adapter that it takes cannot be opened. Free what the message above \
                 says is lacking (memory: also ulimit -v), or update the driver; --backend cpu needs none of it."
            }
            Some(AdapterTrial { state: AdapterState::Wrong, .. }) => {
                "--backend gpu ends with status 3 where its adapter draws wrong."
            }
            Some(AdapterTrial { hardware: false, .. }) => {
                "--backend gpu takes a program that plays a GPU: slower than the CPU engine, good for tests."
            }
            Some(AdapterTrial { hardware: true, .. }) => "Nothing needs to be installed.",
            None => return self.of_none(),
        };
        text.to_owned()
    }

    /// Why there may be no adapter.
    fn of_none(&self) -> String {
        if !self.tried.is_empty() {
            return "--backend gpu finds nothing that it can use: the adapters above can bind too few buffers.".into();
        }
        if let Some(set) = &self.disabled {
            return format!(
                "--backend gpu finds nothing. {set} is set: drivers of these names are passed over. Unset it."
            );
        }
        match &self.drivers {
            Some(set) => format!(
                "--backend gpu finds nothing. {set} is set: drivers are looked for there and nowhere else. Unset it, or name \
                 a driver's JSON file."
            ),
            None if cfg!(target_os = "linux") => {
                "--backend gpu finds nothing. For a GPU install its Vulkan driver (mesa-vulkan-drivers and libvulkan1 on \
                 Debian and Ubuntu, or NVIDIA's); the former bring lavapipe, too, which runs on the CPU."
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
            (None, Some(Right), true, "takes a program that plays a GPU", "status 3"),
            (None, Some(Unusable), false, "--backend gpu ends with status 3: the adapter", "plays a GPU"),
            (None, Some(Wrong), false, "Update the driver", "good for tests"),
            (Some(Right), None, true, "takes the GPU.\nNothing needs to be installed.", "CPU engine"),
            (Some(Right), Some(Unusable), true, "takes the GPU.\nNothing needs", "status 3"),
            (Some(Right), Some(Wrong), false, "Update the driver", "status 3"),
            (Some(Unusable), Some(Right), false, "the CPU engine: the GPU cannot be opened.", "takes the GPU"),
            (Some(Wrong), None, false, "unless it draws wrong", "Nothing needs"),
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
