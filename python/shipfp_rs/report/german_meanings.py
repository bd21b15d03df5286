"""What the symbols of a report mean, in German; the glossary has the English."""

from __future__ import annotations

from collections.abc import Mapping

MEANINGS: Mapping[str, str] = {
    "tau_n": "Zeit, in der das Moment des Betriebspunkts die Trägheit des ganzen Antriebsstrangs auf Betriebsdrehzahl bringt",
    "tau_prop": "Teil von tau_n, der zur Trägheit auf der Propellerseite der Momentmessung gehört",
    "g": "Prozent Motormoment, die 1 % mehr Drehzahl bei fester Füllung bringt",
    "v": "Prozent Motormoment, die 1 % mehr Füllung bei fester Drehzahl bringt",
    "K_p": "Prozent Füllung, die der Regler für 1 % Drehzahlabweichung gibt",
    "K_i": "Prozent Füllung, die der Regler in einer Sekunde für 1 % Drehzahlabweichung hinzugibt",
    "K_d": "Prozent Füllung, die der Regler gibt, während die Drehzahlabweichung um 1 % je Sekunde wächst",
    "vK_p": "Prozent Motormoment für 1 % Drehzahlabweichung: v des Motors mal K_p des Reglers",
    "vK_i": "Prozent Motormoment, die in einer Sekunde für 1 % Drehzahlabweichung hinzukommen: v mal K_i",
    "vK_d": "Prozent Motormoment, während die Drehzahlabweichung um 1 % je Sekunde wächst: v mal K_d",
    "p": "Potenz der Drehzahl, mit der das Propellermoment wächst",
    "T_d": "Totzeit im Kraftstoffweg, innerhalb des Kreises",
    "T_set": "Totzeit im Sollwertweg, vor dem Regler",
    "tau_act": "Zeitkonstante des Kraftstoffstellers",
    "T_s": "Zeit zwischen zwei Abtastungen des Reglers",
    "T_0": "wann der Regler in einer Aufzeichnung zum ersten Mal abtastet",
    "tau_twist": "Nachgiebigkeit der Welle",
    "zeta_twist": "Moment des Dämpfers der verdrehten Welle bei einem Schlupf von Betriebsdrehzahl, je Betriebsmoment",
    "M_max": "obere Grenze des Motormoments, je Betriebsmoment",
    "rate": "wie schnell sich das Moment aus dem Kraftstoff ändern kann, je Betriebsmoment",
    "damping": "Prozent Moment, um die eine Last neben dem Propeller mit 1 % Drehzahl wächst",
    "T_M": "Verzug des Drehmomentkanals",
    "c_2": "Beiwert zweiter Ordnung der Last neben N^p",
    "hold": "Anteil der Totzeit T_d, der vom Abtasten und Halten des Reglers kommt",
    "M_soft": "Breite, über die Rauschen die Momentengrenze rundet",
    "T_n": "Verzug des Drehzahlkanals",
    "k_L": "Beiwert des gemessenen Lastmoments",
}
"""Symbol to its meaning."""
