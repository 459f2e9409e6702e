//! Occupancy grids of random buildings, against rectangles that a clipper of the tests' own cuts.

use glam::DVec2;
use presight_explore::occupancy::{Cell, Grid, GridOptions};
use presight_testkit::buildings::Building;

/// What is wrong with a grid: free cells with missing floor or a box, and other cells that nothing is near.
#[derive(Debug, Default, PartialEq)]
struct Faults {
    wrongly_free: usize,
    wrongly_blocked: usize,
}

fn faults(building: &Building, grid: &Grid) -> Faults {
    let mut faults = Faults::default();
    for (k, cell) in grid.cells.iter().enumerate() {
        let min = grid.origin + grid.cell * DVec2::new((k % grid.width) as f64, (k / grid.width) as f64);
        let square = |grown: f64| {
            let (a, b) = (min - grown, min + grid.cell + grown);
            [a, DVec2::new(b.x, a.y), b, DVec2::new(a.x, b.y)]
        };
        let boxed = |polygon: &[DVec2]| {
            let plan: Vec<DVec2> = polygon.iter().map(|p| building.on_plan(*p)).collect();
            building.boxes.iter().any(|r| r.area_in(&plan) > 0.0)
        };
        // Gaps of a millimetre count as floor.
        let (own, around) = (square(-1.1e-3), square(grid.cell));
        if *cell == Cell::Free {
            faults.wrongly_free += usize::from(building.missing_area(&own) > 1e-9 || boxed(&own));
        } else if building.missing_area(&around) < 1e-9 && !boxed(&around) && building.is_reached(min) {
            faults.wrongly_blocked += 1;
        }
    }
    faults
}

fn grid_of(building: &Building, seed: u64) -> Grid {
    let cell = [0.05, 0.1, 0.17][seed as usize % 3];
    let options = GridOptions::default().with_cell(cell).with_floor(Some(building.height));
    Grid::of(&building.environment, &options).unwrap()
}

/// No cell over missing floor or in a box is free, and no other cell is blocked farther than a cell from anything.
/// `PRESIGHT_BUILDINGS=10000` tests as many; they take a minute.
#[test]
fn grids_of_buildings_are_true() {
    let count = std::env::var("PRESIGHT_BUILDINGS").ok().and_then(|n| n.parse().ok()).unwrap_or(200);
    let mut free = 0;
    for seed in 0..count {
        let building = Building::new(seed);
        let grid = grid_of(&building, seed);
        free += grid.count(Cell::Free);
        assert_eq!(faults(&building, &grid), Faults::default(), "building {seed}");
        if !building.has_yard {
            let usual = Grid::of(&building.environment, &GridOptions::default().with_cell(0.17)).unwrap();
            assert!((usual.floor - building.height).abs() < 1e-3, "building {seed}: {}", usual.floor);
        }
    }
    println!("{count} buildings, {free} free cells");
    assert!(free > 500 * count as usize);
}

/// A grid that tests only the corners of a cell, one of the underside of the slab, and one without a free cell.
#[test]
fn planted_faults_of_grids_are_found() {
    let (mut corners, mut undersides, mut shut) = (0, 0, 0);
    for seed in 0..60 {
        let building = Building::new(seed);
        let mut grid = grid_of(&building, seed);
        let truth = grid.cells.clone();
        for (k, cell) in grid.cells.iter_mut().enumerate() {
            let min = grid.origin + grid.cell * DVec2::new((k % grid.width) as f64, (k / grid.width) as f64);
            let speck =
                |p: DVec2| [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]].map(|c| p + 1e-4 * DVec2::from(c));
            let has_floor = |p: DVec2| building.missing_area(&speck(p)) < 1e-12;
            let at = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]].map(|c| min + grid.cell * DVec2::from(c));
            if at.into_iter().all(has_floor) && building.box_distance(min) > 2.0 * grid.cell {
                *cell = Cell::Free;
            }
        }
        corners += faults(&building, &grid).wrongly_free;
        grid.cells = truth.iter().map(|_| Cell::Unknown).collect();
        shut += faults(&building, &grid).wrongly_blocked;
        let low = GridOptions::default().with_cell(0.1).with_floor(Some(building.height - 0.3));
        undersides += usize::from(Grid::of(&building.environment, &low).unwrap().count(Cell::Free) == 0);
    }
    assert!(corners > 20 && undersides > 20 && shut > 10_000, "{corners}, {undersides}, {shut}");
}
