#![allow(clippy::print_stdout, clippy::unwrap_used, missing_docs)]
use drex_grasp::HandSurface;
fn main(){
    for n in ["leap_right","allegro_right"] {
        let r=drex_robot::Robot::bundled(n).unwrap();
        for s in [0.012,0.008,0.006,0.004,0.003]{
            let h=HandSurface::new(&r,s).unwrap();
            println!("{n} {s} {} {:?}",h.links.iter().map(|l|l.samples.len()).sum::<usize>(),h.links.iter().map(|l|l.samples.len()).collect::<Vec<_>>());
        }
        for f in r.fingers(){println!("{} {:?} {:?} thumb {} tip {:?}",f.name,f.links.iter().map(|&l|r.links[l].name.clone()).collect::<Vec<_>>(),f.joints.iter().map(|&j|r.joints[j].name.clone()).collect::<Vec<_>>(),f.is_thumb,f.tip_point);}
        println!("{:?} {:?}",r.palm_normal(),r.grasp_center());
    }
}
